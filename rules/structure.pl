:- module(structure,
          [ label_planes/3,             % +Planes, +Relations, -Labels
            labelling_cost/4,           % +Planes, +Relations, +Labels, -Cost
            label_cost/3,               % +Plane, ?Label, -Cost
            allowed/5,                  % +Relation, +PlaneA, ?LabelA, +PlaneB, ?LabelB
            supports_label/2,           % ?Class, ?Label
            neutral_class/1,            % ?Class
            structure_area/1,           % ?SquareMetres
            wall_height/1,              % ?Metres
            wall_width/1,               % ?Metres
            wall_ceiling_gap/1,         % ?Metres
            wall_floor_gap/1,           % ?Metres
            ceiling_clearance/1,        % ?Metres
            leaf_height/2,              % ?LowMetres, ?HighMetres
            leaf_width/2,               % ?LowMetres, ?HighMetres
            leaf_floor_gap/1,           % ?Metres
            evident_share/1,            % ?Share
            evidence_weight/1,          % ?Cost
            smallest_weight/1,          % ?Cost
            largest_weight/1,           % ?Cost
            storey_height/1,            % ?Metres
            furniture_share/1,          % ?Share
            room_area/1,                % ?SquareMetres
            search_bound/1,             % ?Inferences
            stairs/1,                   % +Flight
            stairs_levels/1,            % ?Number
            stairs_rise/2,              % ?LowMetres, ?HighMetres
            stairs_going/2,             % ?LowMetres, ?HighMetres
            stairs_unevenness/1,        % ?Metres
            stairs_width/1              % ?Metres
          ]).

/** <module> What the planes of a building are

A constraint network over the planes of a scene, after Nüchter & Hertzberg,
"Towards semantic maps for mobile robots", 2008, section 3.1. Each plane is
one of `wall`, `floor`, `ceiling`, `door` (a leaf that stands ajar) or
`no_feature` (furniture and clutter). The relations `parallel`,
`orthogonal`, `equalheight`, `above` and `under` between planes say which
labels go together; `no_feature` goes with everything. Among the
consistent labellings the one with the fewest and least evident
`no_feature` planes is taken: a weighted constraint optimisation.

A plane is plane(Id, Facing, ZMin, ZMax, Width, Area, Evidence):

  - Facing is `up`, `down`, `side` or `oblique`;
  - ZMin and ZMax are heights [m], Width its horizontal extent [m],
    Area its covered area [m2];
  - Evidence is a list of Class-Share, the share of the plane's surface
    that carries each class label ([] where nothing is labelled), or
    given(Label) for a plane whose label is settled and only serves as
    context for the others.

Example: a table top above a floor cannot be a floor as well.

    ?- label_planes([ plane(1, up, 0.0, 0.0, 4.0, 12.0, []),
                      plane(2, up, 0.7, 0.7, 1.2, 0.9, []) ],
                    [ relation(parallel, 2, 1), relation(above, 2, 1) ],
                    Labels).
    Labels = [1-floor, 2-no_feature].
*/

:- use_module(library(apply)).
:- use_module(library(lists)).
:- use_module(library(pairs)).
:- use_module(library(assoc)).

% -- what to measure with ------------------------------------------------

%!  structure_area(?SquareMetres) is det.
%
%   Structure is at least this large: smaller pieces are reveals, rounded
%   edges and scraps.

structure_area(0.35).

%!  wall_height(?Metres) is det.
%
%   A wall is at least this high: lower uprights are furniture and
%   skirting.

wall_height(1.0).

%!  wall_width(?Metres) is det.
%
%   A wall is at least this wide: narrower uprights are the reveals of
%   doors and windows, frames and pipes.

wall_width(0.35).

%!  wall_ceiling_gap(?Metres) is det.
%
%   A wall reaches up to this close to the ceiling above it, wardrobes and
%   shelves do not.

wall_ceiling_gap(0.3).

%!  wall_floor_gap(?Metres) is det.
%
%   A wall may start this high above the floor, because furniture hides
%   what is below; what starts higher hangs on a wall.

wall_floor_gap(1.6).

%!  ceiling_clearance(?Metres) is det.
%
%   A ceiling is at least this high above the floor: people walk below it.

ceiling_clearance(1.9).

%!  leaf_height(?LowMetres, ?HighMetres) is det.
%
%   Height of a door leaf: people walk through; 5 to 20 cm of it may not
%   have been seen.

leaf_height(1.7, 2.25).

%!  leaf_width(?LowMetres, ?HighMetres) is det.
%
%   Width of a door leaf: 0.6 to 1.2 m, and a cell of the raster.

leaf_width(0.55, 1.25).

%!  leaf_floor_gap(?Metres) is det.
%
%   A door leaf starts this close to the floor.

leaf_floor_gap(0.25).

%!  evident_share(?Share) is det.
%
%   A label is evident when this share of the plane's surface carries
%   classes that support it: the majority.

evident_share(0.5).

%!  evidence_weight(?Cost) is det.
%
%   Cost of going against labels on the whole surface of a plane. As much
%   as a plane of this many square metres: large walls stay walls when half
%   of what was seen on them belongs to something else.

evidence_weight(5.0).

%!  smallest_weight(?Cost) is det.
%
%   Cost of calling even the smallest plane no_feature, so that their
%   number counts.

smallest_weight(0.25).

%!  largest_weight(?Cost) is det.
%
%   Cost of calling the largest plane no_feature. The cost grows with 1 a
%   square metre up to this: a floor outweighs all the tables on it, the
%   halls of a station do not outweigh everything.

largest_weight(40.0).

%!  storey_height(?Metres) is det.
%
%   Walls are higher than this, people reach the top of furniture.

storey_height(2.2).

%!  furniture_share(?Share) is det.
%
%   Uprights below storey_height/1 count with this share of their area: a
%   room may hold more cupboard fronts than it has ceiling.

furniture_share(0.2).

%!  room_area(?SquareMetres) is det.
%
%   The smallest rooms are this large: a smaller level plane counts with
%   the less of its area the smaller it is.

room_area(4.0).

%!  prior_cost(?Label, ?Cost) is det.
%
%   Settles what nothing else settles: a plane of a leaf's size that agrees
%   with the directions of the walls is a piece of wall, another a leaf.

prior_cost(wall, 0.02).
prior_cost(floor, 0.0).
prior_cost(ceiling, 0.0).
prior_cost(door, 0.01).

%!  search_bound(?Inferences) is det.
%
%   After this many inferences (about a fifth of a second) alternatives
%   are no longer tried, and the best labelling found so far is completed.

search_bound(3 000 000).

% -- what steps are stairs -----------------------------------------------

%!  stairs(+Flight) is semidet.
%
%   Flight, flight(Levels, Rise, Unevenness, Going, Width), is stairs: Levels
%   level strips in a row, each Rise above and Going behind the one before,
%   where a rise differs from Rise by Unevenness at most.
%
%       ?- stairs(flight(12, 0.18, 0.01, 0.27, 0.9)).
%       true.

stairs(flight(Levels, Rise, Unevenness, Going, Width)) :-
    stairs_levels(Least),
    Levels >= Least,
    stairs_rise(Low, High),
    Rise >= Low,
    Rise =< High,
    stairs_going(Short, Long),
    Going >= Short,
    Going =< Long,
    stairs_unevenness(Most),
    Unevenness =< Most,
    stairs_width(Narrow),
    Width >= Narrow.

%!  stairs_levels(?Number) is det.
%
%   The floor at the foot is one of them. Fewer are a stool, a plinth or
%   books in a row.

stairs_levels(4).

%!  stairs_rise(?LowMetres, ?HighMetres) is det.
%
%   People climb steps of 15 to 20 cm; garden steps are lower, cellar
%   stairs higher.

stairs_rise(0.1, 0.25).

%!  stairs_going(?LowMetres, ?HighMetres) is det.
%
%   A foot finds room on a step of this depth.

stairs_going(0.2, 0.4).

%!  stairs_unevenness(?Metres) is det.
%
%   One step that differs by more makes people stumble, or was not measured.

stairs_unevenness(0.05).

%!  stairs_width(?Metres) is det.
%
%   People pass; shelves and boxes piled up are narrower.

stairs_width(0.5).

% -- what classes say ----------------------------------------------------

%!  supports_label(?Class, ?Label) is nondet.
%
%   Surfaces of Class are part of a plane with this Label.

supports_label(wall, wall).
supports_label(pillar, wall).
supports_label(column, wall).
supports_label(floor, floor).
supports_label(rug, floor).
supports_label(carpet, floor).
supports_label(mat, floor).
supports_label(ceiling, ceiling).
supports_label(door, door).
supports_label(door_leaf, door).

%!  neutral_class(?Class) is nondet.
%
%   Surfaces of Class lie flat on structure, or are part of it, and say
%   nothing for or against.

neutral_class(window).
neutral_class(curtain).
neutral_class(blinds).
neutral_class(picture).
neutral_class(painting).
neutral_class(poster).
neutral_class(mirror).
neutral_class(whiteboard).
neutral_class(unknown).

% -- what one plane can be -----------------------------------------------

%!  label_cost(+Plane, ?Label, -Cost) is nondet.
%
%   Plane, by itself, can be Label at this cost.

label_cost(plane(_, _, _, _, _, _, given(Label)), Label0, 0.0) :-
    !,
    Label0 = Label.
label_cost(Plane, Label, Cost) :-
    shares(Plane, Shares, Against),
    label_cost(Label, Plane, Shares, Against, Cost).

label_cost(no_feature, Plane, Shares, Against, Cost) :-
    weight(Plane, Weight),
    evidence_weight(Evidence),
    pairs_values(Shares, For),
    sum_list(For, Sum),
    Cost is Weight*(1.0-Against) + Evidence*Sum.
label_cost(Label, Plane, Shares, Against, Cost) :-
    structure_area(Least),
    arg(6, Plane, Area),
    Area >= Least,
    member(Label, [wall, floor, ceiling, door]),
    (   evident(Label, Shares),
        faces(Label, Plane)
    ->  true
    ;   fits(Label, Plane)
    ),
    prior_cost(Label, Prior),
    evidence_weight(Evidence),
    pairs_values(Shares, All),
    sum_list(All, Sum),
    (   memberchk(Label-Own, Shares)
    ->  true
    ;   Own = 0.0
    ),
    Cost is Prior + Evidence*(Against+Sum-Own).

%   How much speaks for a plane's being structure, from its shape alone.

weight(plane(_, Facing, ZMin, ZMax, _, Area, _), Weight) :-
    (   memberchk(Facing, [up, down])
    ->  room_area(Room),
        Share is min(1.0, Area/Room)
    ;   storey_height(Height),
        ZMax-ZMin >= Height
    ->  Share = 1.0
    ;   furniture_share(Share)
    ),
    smallest_weight(Least),
    largest_weight(Most),
    Weight is min(Most, Least+Share*Area).

%   Shares: Label-Share for each label that classes on the plane support.
%   Against: the share of classes that are no structure.

shares(plane(_, _, _, _, _, _, weighed(Shares0, Against0)), Shares, Against) :-
    !,
    Shares = Shares0,
    Against = Against0.
shares(plane(_, _, _, _, _, _, Evidence), Shares, Against) :-
    findall(Label-Share, supporting_share(Evidence, Label, Share), Pairs),
    keysort(Pairs, Sorted),
    group_pairs_by_key(Sorted, Groups),
    sums(Groups, Shares),
    findall(Share, other_share(Evidence, Share), Others),
    sum_list(Others, Against0),
    Against is min(1.0, Against0).

supporting_share(Evidence, Label, Share) :-
    member(Class-Share, Evidence),
    supports_label(Class, Label).

other_share(Evidence, Share) :-
    member(Class-Share, Evidence),
    \+ supports_label(Class, _),
    \+ neutral_class(Class).

sums([], []).
sums([Label-Parts|Groups], [Label-Share|Shares]) :-
    sum_list(Parts, Share),
    sums(Groups, Shares).

evident(Label, Shares) :-
    memberchk(Label-Share, Shares),
    evident_share(Enough),
    Share >= Enough.

%   Most of what was labelled of the plane supports Label, or it is settled.

evident_label(plane(_, _, _, _, _, _, given(Label0)), Label) :-
    !,
    Label == Label0.
evident_label(Plane, Label) :-
    shares(Plane, Shares, _),
    evident(Label, Shares).

faces(wall, plane(_, side, _, _, Width, _, _)) :-
    wall_width(Least),
    Width >= Least.
faces(door, Plane) :-
    faces(wall, Plane).
faces(floor, plane(_, up, _, _, _, _, _)).
faces(floor, plane(_, oblique, _, _, _, _, _)).
faces(ceiling, plane(_, down, _, _, _, _, _)).
faces(ceiling, plane(_, oblique, _, _, _, _, _)).

fits(floor, plane(_, up, _, _, _, _, _)).
fits(ceiling, plane(_, down, _, _, _, _, _)).
fits(wall, Plane) :-
    faces(wall, Plane),
    Plane = plane(_, _, ZMin, ZMax, _, _, _),
    wall_height(Least),
    ZMax-ZMin >= Least.
fits(door, plane(_, side, ZMin, ZMax, Width, _, _)) :-
    leaf_height(Low, High),
    Height is ZMax-ZMin,
    Height >= Low,
    Height =< High,
    leaf_width(Narrow, Wide),
    Width >= Narrow,
    Width =< Wide.

% -- what two planes can be ----------------------------------------------

%!  allowed(+Relation, +PlaneA, ?LabelA, +PlaneB, ?LabelB) is semidet.
%
%   PlaneA and PlaneB, in this Relation, can have these labels. Labels that
%   are evident on both planes need no geometry to confirm them. Of
%   uprights, equalheight says that they meet in a corner and end at the
%   same height: that is a box, and not a leaf, whatever the other is.

allowed(equalheight, A, LabelA, B, LabelB) :-
    once(( LabelA == door ; LabelB == door )),
    !,
    exempt(equalheight, A, LabelA, B, LabelB).
allowed(_, _, no_feature, _, _) :-
    !.
allowed(_, _, _, _, no_feature) :-
    !.
allowed(under, A, LabelA, B, LabelB) :-
    !,
    allowed(above, B, LabelB, A, LabelA).
allowed(Relation, A, LabelA, B, LabelB) :-
    (   goes(Relation, LabelA, LabelB),
        measures(Relation, LabelA, A, LabelB, B)
    ->  true
    ;   exempt(Relation, A, LabelA, B, LabelB)
    ).

%!  goes(?Relation, ?LabelA, ?LabelB) is nondet.
%
%   The network: labels of features that can stand in this relation. A leaf
%   ajar is neither parallel nor at right angles to the walls about it: what
%   is so without being labelled a door is the side of a cupboard.

goes(parallel, wall, wall).
goes(parallel, door, door).
goes(parallel, floor, floor).
goes(parallel, floor, ceiling).
goes(parallel, ceiling, floor).
goes(parallel, ceiling, ceiling).
goes(orthogonal, wall, wall).
goes(orthogonal, wall, floor).
goes(orthogonal, wall, ceiling).
goes(orthogonal, floor, wall).
goes(orthogonal, ceiling, wall).
goes(orthogonal, door, floor).
goes(orthogonal, door, ceiling).
goes(orthogonal, floor, door).
goes(orthogonal, ceiling, door).
goes(equalheight, floor, floor).
goes(equalheight, ceiling, ceiling).
goes(equalheight, wall, wall).
goes(above, ceiling, floor).
goes(above, ceiling, wall).
goes(above, ceiling, door).
goes(above, wall, floor).
goes(above, door, floor).

measures(above, ceiling, plane(_, _, Z, _, _, _, _), floor, plane(_, _, _, Z0, _, _, _)) :-
    !,
    ceiling_clearance(Least),
    Z-Z0 >= Least.
measures(above, ceiling, plane(_, _, Z, _, _, _, _), wall, plane(_, _, _, Top, _, _, _)) :-
    !,
    wall_ceiling_gap(Most),
    Z-Top =< Most.
measures(above, wall, plane(_, _, Bottom, _, _, _, _), floor, plane(_, _, _, Z, _, _, _)) :-
    !,
    wall_floor_gap(Most),
    Bottom-Z =< Most.
measures(above, door, plane(_, _, Bottom, _, _, _, _), floor, plane(_, _, _, Z, _, _, _)) :-
    !,
    leaf_floor_gap(Most),
    Bottom-Z =< Most.
measures(_, _, _, _, _).

%   Labels that were seen outweigh geometry: both seen, a leaf that was
%   seen to be one, a wall that was seen to be one though its upper part
%   was not seen.

exempt(_, A, LabelA, B, LabelB) :-
    evident_label(A, LabelA),
    evident_label(B, LabelB),
    !.
exempt(Relation, A, door, _, _) :-
    memberchk(Relation, [parallel, orthogonal, equalheight]),
    evident_label(A, door),
    !.
exempt(Relation, _, _, B, door) :-
    memberchk(Relation, [parallel, orthogonal, equalheight]),
    evident_label(B, door),
    !.
exempt(above, A, wall, _, floor) :-
    evident_label(A, wall),
    !.
exempt(above, _, ceiling, B, wall) :-
    evident_label(B, wall).

% -- what a leaf stands on -----------------------------------------------

%   OnFloor: the ids of the planes that stand on something that may be a
%   floor, as an assoc.

on_floor(Planes, Relations, OnFloor) :-
    findall(Id-Plane, ( member(Plane, Planes), arg(1, Plane, Id) ), Pairs),
    list_to_assoc(Pairs, PlaneOf),
    findall(Upper,
            ( member(Relation, Relations),
              over(Relation, Upper, Lower),
              get_assoc(Upper, PlaneOf, Leaf),
              get_assoc(Lower, PlaneOf, Floor),
              measures(above, door, Leaf, floor, Floor),
              once(label_cost(Floor, floor, _))
            ),
            Standing),
    sort(Standing, Ids),
    findall(Id-true, member(Id, Ids), Marked),
    list_to_assoc(Marked, OnFloor).

over(relation(above, Upper, Lower), Upper, Lower).
over(relation(under, Lower, Upper), Upper, Lower).

%   A leaf needs a floor to stand on, unless it was seen to be one.

grounded(door, Plane, OnFloor) :-
    !,
    (   evident_label(Plane, door)
    ->  true
    ;   arg(1, Plane, Id),
        get_assoc(Id, OnFloor, true)
    ).
grounded(_, _, _).

% -- the cheapest consistent labelling -----------------------------------

%!  labelling_cost(+Planes, +Relations, +Labels, -Cost) is semidet.
%
%   Labels, a list of Id-Label, is consistent and costs Cost. Says what
%   label_planes/3 minimises.

labelling_cost(Planes, Relations, Labels, Cost) :-
    costs(Planes, Labels, 0.0, Cost),
    on_floor(Planes, Relations, OnFloor),
    forall(( member(Plane, Planes), arg(1, Plane, Id), memberchk(Id-Label, Labels) ),
           grounded(Label, Plane, OnFloor)),
    forall(member(relation(Relation, A, B), Relations),
           ( memberchk(A-LabelA, Labels),
             memberchk(B-LabelB, Labels),
             memberchk(plane(A, A1, A2, A3, A4, A5, A6), Planes),
             memberchk(plane(B, B1, B2, B3, B4, B5, B6), Planes),
             allowed(Relation, plane(A, A1, A2, A3, A4, A5, A6), LabelA,
                     plane(B, B1, B2, B3, B4, B5, B6), LabelB)
           )).

costs([], _, Cost, Cost).
costs([Plane|Planes], Labels, Cost0, Cost) :-
    arg(1, Plane, Id),
    memberchk(Id-Label, Labels),
    label_cost(Plane, Label, C),
    !,
    Cost1 is Cost0+C,
    costs(Planes, Labels, Cost1, Cost).

%!  label_planes(+Planes, +Relations, -Labels) is det.
%
%   Labels is a list of Id-Label, in the order of Planes: the cheapest
%   consistent labelling, or the best found within search_bound/1.
%   Relations is a list of relation(Name, IdA, IdB).
%
%   Branch and bound with forward checking. Domains are bit masks; the
%   bound is the sum of what each open plane costs at least. Whenever the
%   open planes fall apart into parts without constraints between them,
%   each part is solved for itself.

label_planes([], _, []) :-
    !.
label_planes(Planes0, Relations, Labels) :-
    maplist(weighed, Planes0, Planes),
    length(Planes, N),
    compound_name_arguments(Vector, planes, Planes),
    compound_name_arity(Options, options, N),
    compound_name_arity(Domains, domains, N),
    on_floor(Planes, Relations, OnFloor),
    start_domains(N, Vector, OnFloor, Options, Domains),
    arcs(Relations, Vector, Domains, Arcs),
    spread_settled(N, Arcs, Domains),
    search_bound(Bound),
    statistics(inferences, Now),
    Deadline is Now+Bound,
    numlist(1, N, All),
    divide(All, Domains, Open, Settled),
    unbounded(Unbounded),
    solve_parts(Open, network(Domains, Options, Arcs, Deadline), Unbounded, _, Choice),
    chosen(Settled, Domains, Choice, Bits),
    keysort(Bits, Sorted),
    read_labels(Planes, Sorted, Labels).

unbounded(1.0e12).

%   weighed(+Plane0, -Plane): with the evidence summed up once, weighed(Shares, Against), in its place.
weighed(Plane0, Plane) :-
    Plane0 = plane(Id, Facing, ZMin, ZMax, Width, Area, Evidence),
    (   Evidence = given(_)
    ->  Plane = Plane0
    ;   shares(Plane0, Shares, Against),
        Plane = plane(Id, Facing, ZMin, ZMax, Width, Area, weighed(Shares, Against))
    ).

chosen([], _, Choice, Choice).
chosen([I|Is], Domains, Choice, [I-Bit|Bits]) :-
    arg(I, Domains, Bit),
    chosen(Is, Domains, Choice, Bits).

read_labels([], [], []).
read_labels([Plane|Planes], [_-Bit|Bits], [Id-Label|Labels]) :-
    arg(1, Plane, Id),
    bit(Label, Bit),
    read_labels(Planes, Bits, Labels).

bit(wall, 1).
bit(floor, 2).
bit(ceiling, 4).
bit(door, 8).
bit(no_feature, 16).

%   Options: for each plane its Cost-Bit, cheapest first. Domains: which
%   bits are still possible.

start_domains(0, _, _, _, _) :-
    !.
start_domains(I, Vector, OnFloor, Options, Domains) :-
    arg(I, Vector, Plane),
    findall(Cost-Bit,
            ( label_cost(Plane, Label, Cost), grounded(Label, Plane, OnFloor), bit(Label, Bit) ),
            Pairs),
    keysort(Pairs, Sorted),
    arg(I, Options, Sorted),
    union_of_bits(Sorted, 0, Mask),
    arg(I, Domains, Mask),
    I1 is I-1,
    start_domains(I1, Vector, OnFloor, Options, Domains).

union_of_bits([], Mask, Mask).
union_of_bits([_-Bit|Pairs], Mask0, Mask) :-
    Mask1 is Mask0 \/ Bit,
    union_of_bits(Pairs, Mask1, Mask).

open(Mask) :-
    Mask /\ (Mask-1) =\= 0.

%   The planes with a choice left, and those without.

divide([], _, [], []).
divide([I|Is], Domains, Open, Settled) :-
    arg(I, Domains, Mask),
    (   open(Mask)
    ->  Open = [I|Open1],
        divide(Is, Domains, Open1, Settled)
    ;   Settled = [I|Settled1],
        divide(Is, Domains, Open, Settled1)
    ).

%   Arcs: argument I is a list of J-Masks, where Masks is m(Wall, Floor,
%   Ceiling, Door, NoFeature): what J can be for each label of I.

arcs(Relations, Vector, Domains, Arcs) :-
    compound_name_arguments(Vector, _, Planes),
    number_ids(Planes, 1, Numbered),
    list_to_assoc(Numbered, Index),
    findall(Arc,
            ( member(relation(Relation, A, B), Relations),
              get_assoc(A, Index, I),
              get_assoc(B, Index, J),
              arc(Relation, I, J, Vector, Domains, Arc)
            ),
            Pairs),
    keysort(Pairs, Sorted),
    group_pairs_by_key(Sorted, Groups),
    length(Planes, N),
    fill(1, N, Groups, Lists),
    compound_name_arguments(Arcs, arcs, Lists).

number_ids([], _, []).
number_ids([Plane|Planes], I, [Id-I|Pairs]) :-
    arg(1, Plane, Id),
    I1 is I+1,
    number_ids(Planes, I1, Pairs).

fill(I, N, _, []) :-
    I > N,
    !.
fill(I, N, Groups, [List|Lists]) :-
    (   Groups = [I-List|Groups1]
    ->  true
    ;   List = [],
        Groups1 = Groups
    ),
    I1 is I+1,
    fill(I1, N, Groups1, Lists).

arc(Relation, I, J, Vector, Domains, Arc) :-
    arg(I, Vector, A),
    arg(J, Vector, B),
    arg(I, Domains, DomainA),
    arg(J, Domains, DomainB),
    once(( open(DomainA) ; open(DomainB) )),        % else there is no choice to guide
    \+ indifferent(Relation, DomainA, DomainB),
    findall(BitA-BitB,
            ( bit(LabelA, BitA),
              DomainA /\ BitA =\= 0,
              bit(LabelB, BitB),
              DomainB /\ BitB =\= 0,
              allowed(Relation, A, LabelA, B, LabelB)
            ),
            Pairs),
    length(Pairs, Many),
    Many < popcount(DomainA)*popcount(DomainB),     % else no constraint
    (   masks(Pairs, Masks),
        Arc = I-(J-Masks)
    ;   transpose_pairs(Pairs, Turned),
        masks(Turned, Masks),
        Arc = J-(I-Masks)
    ).

%   What can only be no_feature leaves the other plane free, but for the leaf that ends where a box does.
indifferent(Relation, DomainA, DomainB) :-
    ( DomainA =:= 16 ; DomainB =:= 16 ),
    !,
    Relation \== equalheight.

masks(Pairs, m(Wall, Floor, Ceiling, Door, NoFeature)) :-
    mask(Pairs, 1, 0, Wall),
    mask(Pairs, 2, 0, Floor),
    mask(Pairs, 4, 0, Ceiling),
    mask(Pairs, 8, 0, Door),
    mask(Pairs, 16, 0, NoFeature).

mask([], _, Mask, Mask).
mask([X-Y|Pairs], Bit, Mask0, Mask) :-
    (   X =:= Bit
    ->  Mask1 is Mask0 \/ Y
    ;   Mask1 = Mask0
    ),
    mask(Pairs, Bit, Mask1, Mask).

mask_for(1, m(M, _, _, _, _), M).
mask_for(2, m(_, M, _, _, _), M).
mask_for(4, m(_, _, M, _, _), M).
mask_for(8, m(_, _, _, M, _), M).
mask_for(16, m(_, _, _, _, M), M).

%   Planes that can only be one thing restrict the others before the search.
%   Settled planes that contradict each other are left as they are.

spread_settled(0, _, _) :-
    !.
spread_settled(I, Arcs, Domains) :-
    arg(I, Domains, Mask),
    (   open(Mask)
    ->  true
    ;   arg(I, Arcs, List),
        restrict_open(List, Mask, Domains)
    ),
    I1 is I-1,
    spread_settled(I1, Arcs, Domains).

restrict_open([], _, _).
restrict_open([J-Masks|List], Bit, Domains) :-
    arg(J, Domains, Old),
    (   open(Old)
    ->  mask_for(Bit, Masks, Mask),
        New is Old /\ Mask,
        setarg(J, Domains, New)
    ;   true
    ),
    restrict_open(List, Bit, Domains).

%   forward_check(+Neighbours, +Bit, +Arcs, +Domains) is semidet.
%
%   Take from the neighbours what does not go with Bit, and go on from those
%   that have one label left; fails when one has none.

forward_check([], _, _, _).
forward_check([J-Masks|Neighbours], Bit, Arcs, Domains) :-
    arg(J, Domains, Old),
    mask_for(Bit, Masks, Mask),
    New is Old /\ Mask,
    (   New =:= Old
    ->  true
    ;   New =\= 0,
        setarg(J, Domains, New),
        (   open(New)
        ->  true
        ;   arg(J, Arcs, Next),
            forward_check(Next, New, Arcs, Domains)
        )
    ),
    forward_check(Neighbours, Bit, Arcs, Domains).

%   solve_parts(+Open, +Network, +Bound, -Cost, -Choice) is semidet.
%
%   The cheapest labels of the planes Open (a list of their numbers) as
%   Number-Bit; fails when there are none cheaper than Bound.

solve_parts([], _, Bound, 0.0, []) :-
    !,
    Bound > 0.0.
solve_parts(Open, Network, Bound, Cost, Choice) :-
    Network = network(Domains, Options, Arcs, _),
    least_cost(Open, Domains, Options, 0.0, Least),
    Least < Bound,
    parts(Open, Domains, Arcs, Parts),
    solve_each(Parts, Network, Bound, Least, Cost, [], Choice).

solve_each([], _, _, Cost, Cost, Choice, Choice).
solve_each([Part|Parts], Network, Bound, Cost0, Cost, Choice0, Choice) :-
    Network = network(Domains, Options, _, _),
    least_cost(Part, Domains, Options, 0.0, Least),
    PartBound is Bound-Cost0+Least,
    solve(Part, Network, PartBound, PartCost, PartChoice),
    append(PartChoice, Choice0, Choice1),
    Cost1 is Cost0-Least+PartCost,
    solve_each(Parts, Network, Bound, Cost1, Cost, Choice1, Choice).

least_cost([], _, _, Cost, Cost).
least_cost([I|Is], Domains, Options, Cost0, Cost) :-
    arg(I, Domains, Mask),
    arg(I, Options, List),
    cheapest(List, Mask, C, _),
    Cost1 is Cost0+C,
    least_cost(Is, Domains, Options, Cost1, Cost).

cheapest([C-Bit|Options], Mask, Cost, Label) :-
    (   Bit /\ Mask =\= 0
    ->  Cost = C,
        Label = Bit
    ;   cheapest(Options, Mask, Cost, Label)
    ).

%   One part: branch on the plane that most others depend on. Best keeps the
%   cheapest solution over the alternatives, which are left by failure, so
%   that the domains are restored.

solve([I], network(Domains, Options, _, _), Bound, Cost, [I-Bit]) :-
    !,
    arg(I, Domains, Mask),
    arg(I, Options, List),
    cheapest(List, Mask, Cost, Bit),
    Cost < Bound.
solve(Part, Network, Bound, Cost, Choice) :-
    Network = network(Domains, Options, Arcs, Deadline),
    branching_plane(Part, Network, I),
    arg(I, Options, List),
    arg(I, Arcs, Neighbours),
    arg(I, Domains, Mask),
    selectchk(I, Part, Rest),
    Best = best(Bound, none),
    (   member(C-Bit, List),
        Bit /\ Mask =\= 0,
        in_time(Best, Deadline),
        setarg(I, Domains, Bit),
        forward_check(Neighbours, Bit, Arcs, Domains),
        divide(Rest, Domains, Open, Settled),
        least_cost(Settled, Domains, Options, C, Cost0),
        arg(1, Best, Ceiling),
        Spare is Ceiling-Cost0,
        solve_parts(Open, Network, Spare, OpenCost, OpenChoice),
        chosen([I|Settled], Domains, OpenChoice, Solution),
        Total is Cost0+OpenCost,
        nb_setarg(1, Best, Total),
        nb_setarg(2, Best, Solution),
        fail
    ;   Best = best(Cost, Choice),
        Choice \== none
    ).

%   Late, only what has no solution at all yet is still solved.

in_time(best(Bound, none), _) :-
    unbounded(Unbounded),
    Bound > 0.5*Unbounded,
    !.
in_time(_, Deadline) :-
    statistics(inferences, Now),
    Now < Deadline.

%   The open plane of a part with the most open neighbours; of equals the
%   one that would cost most as no_feature.

branching_plane(Part, network(Domains, Options, Arcs, _), Plane) :-
    keyed(Part, Domains, Options, Arcs, Keyed),
    max_member(_-Plane, Keyed).

keyed([], _, _, _, []).
keyed([I|Is], Domains, Options, Arcs, [k(Degree, Weight)-I|Keyed]) :-
    arg(I, Arcs, Neighbours),
    degree(Neighbours, Domains, 0, Degree),
    arg(I, Options, List),
    last(List, Weight-_),
    keyed(Is, Domains, Options, Arcs, Keyed).

degree([], _, Degree, Degree).
degree([J-_|Neighbours], Domains, Degree0, Degree) :-
    arg(J, Domains, Mask),
    (   open(Mask)
    ->  Degree1 is Degree0+1
    ;   Degree1 = Degree0
    ),
    degree(Neighbours, Domains, Degree1, Degree).

%   The parts that open planes fall into.

parts(Open, Domains, Arcs, Parts) :-
    compound_name_arity(Domains, _, N),
    compound_name_arity(Marks, marks, N),
    parts_(Open, Domains, Arcs, Marks, Parts).

parts_([], _, _, _, []).
parts_([I|Is], Domains, Arcs, Marks, Parts) :-
    arg(I, Marks, Mark),
    (   nonvar(Mark)
    ->  parts_(Is, Domains, Arcs, Marks, Parts)
    ;   Mark = seen,
        reach([I], Domains, Arcs, Marks, Part),
        Parts = [Part|Parts1],
        parts_(Is, Domains, Arcs, Marks, Parts1)
    ).

reach([], _, _, _, []).
reach([I|Stack], Domains, Arcs, Marks, [I|Part]) :-
    arg(I, Arcs, Neighbours),
    push(Neighbours, Domains, Marks, Stack, Stack1),
    reach(Stack1, Domains, Arcs, Marks, Part).

push([], _, _, Stack, Stack).
push([J-_|Neighbours], Domains, Marks, Stack0, Stack) :-
    arg(J, Marks, Mark),
    (   var(Mark),
        arg(J, Domains, Mask),
        open(Mask)
    ->  Mark = seen,
        push(Neighbours, Domains, Marks, [J|Stack0], Stack)
    ;   push(Neighbours, Domains, Marks, Stack0, Stack)
    ).
