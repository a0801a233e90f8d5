:- module(structure,
          [ label_planes/3,             % +Planes, +Relations, -Labels
            labelling_cost/4,           % +Planes, +Relations, +Labels, -Cost
            label_cost/3,               % +Plane, ?Label, -Cost
            allowed/5,                  % +Relation, +PlaneA, ?LabelA, +PlaneB, ?LabelB
            supports_label/2,           % ?Class, ?Label
            neutral_class/1,            % ?Class
            wall_height/1,              % ?Metres
            wall_ceiling_gap/1,         % ?Metres
            wall_floor_gap/1,           % ?Metres
            ceiling_clearance/1,        % ?Metres
            leaf_height/2,              % ?LowMetres, ?HighMetres
            leaf_width/2,               % ?LowMetres, ?HighMetres
            leaf_floor_gap/1,           % ?Metres
            evident_share/1,            % ?Share
            evidence_weight/1,          % ?Cost
            largest_weight/1,           % ?Cost
            search_bound/1              % ?Inferences
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

%!  wall_height(?Metres) is det.
%
%   A wall is at least this high: lower uprights are furniture and
%   skirting.

wall_height(1.0).

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
%   Cost of going against labels on the whole surface of a plane. More
%   than half of largest_weight/1: labels beat size unless they are
%   divided.

evidence_weight(5.0).

%!  smallest_weight(?Cost) is det.
%
%   Cost of calling even the smallest plane no_feature, so that their
%   number counts.

smallest_weight(0.5).

%!  largest_weight(?Cost) is det.
%
%   Cost of calling a large plane no_feature; grows with 1 a square metre
%   up to this. Walls are all large: which is larger says no more.

largest_weight(6.0).

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
    supports(Plane, Shares),
    against(Plane, Shares, Against),
    label_cost(Label, Plane, Shares, Against, Cost).

label_cost(no_feature, plane(_, _, _, _, _, Area, _), Shares, Against, Cost) :-
    smallest_weight(Least),
    largest_weight(Most),
    evidence_weight(Evidence),
    foldl([_-S, T0, T]>>(T is T0+S), Shares, 0.0, For),
    Cost is min(Least+Area, Most)*(1.0-Against) + Evidence*For.
label_cost(Label, Plane, Shares, Against, Cost) :-
    member(Label, [wall, floor, ceiling, door]),
    (   evident(Label, Shares),
        faces(Label, Plane)
    ->  true
    ;   fits(Label, Plane)
    ),
    prior_cost(Label, Prior),
    evidence_weight(Evidence),
    foldl([L-S, T0, T]>>(L == Label -> T = T0 ; T is T0+S), Shares, Against, Wrong),
    Cost is Prior + Evidence*Wrong.

supports(plane(_, _, _, _, _, _, Evidence), Shares) :-
    (   Evidence = [_|_]
    ->  findall(Label-Share,
                ( member(Label, [wall, floor, ceiling, door]),
                  aggregate_share(Evidence, Label, Share),
                  Share > 0.0
                ),
                Shares)
    ;   Shares = []
    ).

aggregate_share(Evidence, Label, Share) :-
    findall(S, ( member(Class-S, Evidence), supports_label(Class, Label) ), Ss),
    sum_list(Ss, Share).

against(plane(_, _, _, _, _, _, Evidence), Shares, Against) :-
    (   Evidence = [_|_]
    ->  findall(S,
                ( member(Class-S, Evidence),
                  \+ supports_label(Class, _),
                  \+ neutral_class(Class)
                ),
                Ss),
        sum_list(Ss, Sum),
        foldl([_-S, T0, T]>>(T is T0+S), Shares, Sum, All),
        Against is Sum / max(1.0, All)
    ;   Against = 0.0
    ).

evident(Label, Shares) :-
    memberchk(Label-Share, Shares),
    evident_share(Enough),
    Share >= Enough.

%!  evident(+Plane, +Label) is semidet.
%
%   Most of the Plane's surface carries labels that support Label.

evident_label(plane(_, _, _, _, _, _, given(Label0)), Label) :-
    !,
    Label == Label0.
evident_label(plane(_, _, _, _, _, _, Evidence), Label) :-
    Evidence = [_|_],
    aggregate_share(Evidence, Label, Share),
    evident_share(Enough),
    Share >= Enough.

faces(wall, plane(_, side, _, _, _, _, _)).
faces(wall, plane(_, oblique, _, _, _, _, _)).
faces(door, plane(_, side, _, _, _, _, _)).
faces(floor, plane(_, up, _, _, _, _, _)).
faces(floor, plane(_, oblique, _, _, _, _, _)).
faces(ceiling, plane(_, down, _, _, _, _, _)).
faces(ceiling, plane(_, oblique, _, _, _, _, _)).

fits(floor, plane(_, up, _, _, _, _, _)).
fits(ceiling, plane(_, down, _, _, _, _, _)).
fits(wall, plane(_, side, ZMin, ZMax, _, _, _)) :-
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
%   are evident on both planes need no geometry to confirm them.

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
goes(equalheight, door, door).
goes(above, ceiling, floor).
goes(above, ceiling, wall).
goes(above, ceiling, door).
goes(above, wall, floor).
goes(above, door, floor).

measures(above, ceiling, plane(_, _, Z, _, _, _, _), floor, plane(_, _, _, Z0, _, _, _)) :-
    !,
    ceiling_clearance(Least),
    Z - Z0 >= Least.
measures(above, ceiling, plane(_, _, Z0, Z1, _, _, _), wall, plane(_, _, _, Top, _, _, _)) :-
    !,
    wall_ceiling_gap(Most),
    0.5*(Z0+Z1) - Top =< Most.
measures(above, wall, plane(_, _, Bottom, _, _, _, _), floor, plane(_, _, Z0, Z1, _, _, _)) :-
    !,
    wall_floor_gap(Most),
    Bottom - 0.5*(Z0+Z1) =< Most.
measures(above, door, plane(_, _, Bottom, _, _, _, _), floor, plane(_, _, Z0, Z1, _, _, _)) :-
    !,
    leaf_floor_gap(Most),
    Bottom - 0.5*(Z0+Z1) =< Most.
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

% -- the cheapest consistent labelling -----------------------------------

%!  labelling_cost(+Planes, +Relations, +Labels, -Cost) is semidet.
%
%   Labels, a list of Id-Label, is consistent and costs Cost. Says what
%   label_planes/3 minimises.

labelling_cost(Planes, Relations, Labels, Cost) :-
    foldl([Plane, C0, C]>>( arg(1, Plane, Id),
                            memberchk(Id-Label, Labels),
                            label_cost(Plane, Label, C1),
                            C is C0+C1
                          ),
          Planes, 0.0, Cost),
    forall(member(relation(Relation, A, B), Relations),
           ( plane_of(A, Planes, PlaneA),
             plane_of(B, Planes, PlaneB),
             memberchk(A-LabelA, Labels),
             memberchk(B-LabelB, Labels),
             allowed(Relation, PlaneA, LabelA, PlaneB, LabelB)
           )).

plane_of(Id, Planes, Plane) :-
    Plane = plane(Id, _, _, _, _, _, _),
    memberchk(Plane, Planes).

%!  label_planes(+Planes, +Relations, -Labels) is det.
%
%   Labels is a list of Id-Label, in the order of Planes: the cheapest
%   consistent labelling, or the best found within search_bound/1.
%   Relations is a list of relation(Name, IdA, IdB).
%
%   Branch and bound with forward checking: domains are bit masks, the
%   bound is the sum of what each open plane costs at least. Whenever the
%   open planes fall apart into parts without constraints between them, each
%   part is solved for itself.

label_planes(Planes, Relations, Labels) :-
    length(Planes, N),
    compound_name_arguments(Vector, planes, Planes),
    numbered_ids(Planes, Index),
    functor(Options, options, N),
    functor(Domains, domains, N),
    start_domains(N, Vector, Options, Domains),
    arcs(Relations, Index, Vector, Domains, N, Arcs),
    reduce_settled(N, Arcs, Domains),
    search_bound(Bound),
    statistics(inferences, Now),
    Deadline is Now+Bound,
    Network = network(Domains, Options, Arcs, Deadline),
    findall(I, ( between(1, N, I), open_plane(Domains, I) ), Open),
    solve_parts(Open, Network, 1.0e12, _, [], Choice),
    read_labels(1, Planes, Domains, Choice, Labels).

numbered_ids(Planes, Index) :-
    findall(Id-I, ( nth1(I, Planes, Plane), arg(1, Plane, Id) ), Pairs),
    list_to_assoc(Pairs, Index).

read_labels(_, [], _, _, []).
read_labels(I, [Plane|Planes], Domains, Choice, [Id-Label|Labels]) :-
    arg(1, Plane, Id),
    (   memberchk(I-Bit, Choice)
    ->  true
    ;   arg(I, Domains, Bit)
    ),
    bit(Label, Bit),
    I1 is I+1,
    read_labels(I1, Planes, Domains, Choice, Labels).

bit(wall, 1).
bit(floor, 2).
bit(ceiling, 4).
bit(door, 8).
bit(no_feature, 16).

%   Options: for each plane its Cost-Bit, cheapest first. Domains: the
%   union of the bits.

start_domains(0, _, _, _) :-
    !.
start_domains(I, Vector, Options, Domains) :-
    arg(I, Vector, Plane),
    findall(Cost-Bit, ( label_cost(Plane, Label, Cost), bit(Label, Bit) ), Pairs),
    keysort(Pairs, Sorted),
    arg(I, Options, Sorted),
    foldl([_-Bit, M0, M]>>(M is M0 \/ Bit), Sorted, 0, Mask),
    arg(I, Domains, Mask),
    I1 is I-1,
    start_domains(I1, Vector, Options, Domains).

open_plane(Domains, I) :-
    arg(I, Domains, Mask),
    Mask /\ (Mask-1) =\= 0.

%   Arcs: arg I is a list of J-Masks, where Masks is m(Wall, Floor, Ceiling,
%   Door, NoFeature): what J can be for each label of I.

arcs(Relations, Index, Vector, Domains, N, Arcs) :-
    findall(I-(J-Masks),
            ( member(relation(Relation, A, B), Relations),
              get_assoc(A, Index, IA),
              get_assoc(B, Index, IB),
              arc(Relation, IA, IB, Vector, Domains, I, J, Masks)
            ),
            Pairs),
    keysort(Pairs, Sorted),
    functor(Arcs, arcs, N),
    group_pairs_by_key(Sorted, Groups),
    maplist([I-L]>>arg(I, Arcs, L), Groups),
    forall(fail, true),
    fill_empty(N, Arcs).

fill_empty(0, _) :-
    !.
fill_empty(I, Arcs) :-
    arg(I, Arcs, List),
    (   var(List)
    ->  List = []
    ;   true
    ),
    I1 is I-1,
    fill_empty(I1, Arcs).

arc(Relation, A, B, Vector, Domains, I, J, Masks) :-
    arg(A, Vector, PlaneA),
    arg(B, Vector, PlaneB),
    arg(A, Domains, DomainA),
    arg(B, Domains, DomainB),
    pairs_allowed(Relation, PlaneA, DomainA, PlaneB, DomainB, Pairs),
    (   I = A,
        J = B,
        masks(Pairs, DomainB, Masks)
    ;   I = B,
        J = A,
        findall(Y-X, member(X-Y, Pairs), Turned),
        masks(Turned, DomainA, Masks)
    ).

%   The pairs of bits that go together; fails where all do.

pairs_allowed(Relation, PlaneA, DomainA, PlaneB, DomainB, Pairs) :-
    findall(BitA-BitB,
            ( bit(LabelA, BitA), DomainA /\ BitA =\= 0,
              bit(LabelB, BitB), DomainB /\ BitB =\= 0,
              allowed(Relation, PlaneA, LabelA, PlaneB, LabelB)
            ),
            Pairs),
    length(Pairs, Many),
    Many < popcount(DomainA)*popcount(DomainB).

masks(Pairs, _Domain, m(Wall, Floor, Ceiling, Door, NoFeature)) :-
    mask(1, Pairs, Wall),
    mask(2, Pairs, Floor),
    mask(4, Pairs, Ceiling),
    mask(8, Pairs, Door),
    mask(16, Pairs, NoFeature).

mask(Bit, Pairs, Mask) :-
    foldl([X-Y, M0, M]>>(X =:= Bit -> M is M0 \/ Y ; M = M0), Pairs, 0, Mask).

allowed_mask(1, m(M, _, _, _, _), M).
allowed_mask(2, m(_, M, _, _, _), M).
allowed_mask(4, m(_, _, M, _, _), M).
allowed_mask(8, m(_, _, _, M, _), M).
allowed_mask(16, m(_, _, _, _, M), M).

%   Planes that can only be one thing restrict the others before the search.

reduce_settled(N, Arcs, Domains) :-
    findall(I, ( between(1, N, I), \+ open_plane(Domains, I) ), Settled),
    maplist([I]>>( arg(I, Domains, Bit), arg(I, Arcs, List), restrict(List, Bit, Domains) ), Settled).

restrict([], _, _).
restrict([J-Masks|Arcs], Bit, Domains) :-
    allowed_mask(Bit, Masks, Mask),
    arg(J, Domains, Old),
    New is Old /\ Mask,
    (   New =:= Old
    ->  true
    ;   New =:= 0
    ->  true
    ;   setarg(J, Domains, New)
    ),
    restrict(Arcs, Bit, Domains).

%!  solve_parts(+Open, +Network, +Bound, -Cost, +Choice0, -Choice) is semidet.
%
%   The cheapest labels of the planes Open (a list of their numbers), part
%   by part, as Number-Bit before Choice0; fails when there is none cheaper
%   than Bound.

solve_parts(Open, Network, Bound, Cost, Choice0, Choice) :-
    Network = network(Domains, Options, Arcs, _),
    least_cost(Open, Domains, Options, 0.0, Least),
    Least < Bound,
    parts(Open, Domains, Arcs, Parts),
    solve_each(Parts, Network, Bound, Least, Cost, Choice0, Choice).

solve_each([], _, _, Cost, Cost, Choice, Choice).
solve_each([Part|Parts], Network, Bound, Cost0, Cost, Choice0, Choice) :-
    Network = network(Domains, Options, _, _),
    least_cost(Part, Domains, Options, 0.0, Least),
    Spare is Bound - (Cost0-Least),
    solve(Part, Network, Spare, PartCost, PartChoice),
    append(PartChoice, Choice0, Choice1),
    Cost1 is Cost0 - Least + PartCost,
    solve_each(Parts, Network, Bound, Cost1, Cost, Choice1, Choice).

least_cost([], _, _, Cost, Cost).
least_cost([I|Is], Domains, Options, Cost0, Cost) :-
    cheapest(I, Domains, Options, C),
    Cost1 is Cost0+C,
    least_cost(Is, Domains, Options, Cost1, Cost).

cheapest(I, Domains, Options, Cost) :-
    arg(I, Domains, Mask),
    arg(I, Options, List),
    first_in(List, Mask, Cost).

first_in([C-Bit|More], Mask, Cost) :-
    (   Bit /\ Mask =\= 0
    ->  Cost = C
    ;   first_in(More, Mask, Cost)
    ).

%   One part: branch on its most constraining plane.

solve([I], network(Domains, Options, _, _), Bound, Cost, [I-Bit]) :-
    !,
    arg(I, Domains, Mask),
    arg(I, Options, List),
    member(Cost-Bit, List),
    Bit /\ Mask =\= 0,
    !,
    Cost < Bound.
solve(Part, Network, Bound, Cost, Choice) :-
    Network = network(Domains, Options, Arcs, Deadline),
    branching_plane(Part, Arcs, Options, I),
    exclude(==(I), Part, Rest),
    arg(I, Domains, Mask),
    arg(I, Options, List),
    Best = best(Bound, none),
    (   member(C-Bit, List),
        Bit /\ Mask =\= 0,
        arg(2, Best, Found),
        (   Found \== none,
            statistics(inferences, Now),
            Now > Deadline
        ->  !,
            fail
        ;   true
        ),
        setarg(I, Domains, Bit),
        arg(I, Arcs, Neighbours),
        forward_check(Neighbours, Bit, Domains),
        arg(1, Best, Ceiling),
        Spare is Ceiling-C,
        partition([J]>>open_plane(Domains, J), Rest, Open, Fixed),
        fixed_cost(Fixed, Domains, Options, 0.0, FixedCost, FixedChoice),
        consistent(Fixed, Arcs, Domains),
        Spare1 is Spare-FixedCost,
        solve_parts(Open, Network, Spare1, OpenCost, [I-Bit|FixedChoice], Solution),
        Total is C+FixedCost+OpenCost,
        Total < Ceiling,
        nb_setarg(1, Best, Total),
        nb_setarg(2, Best, Solution),
        fail
    ;   true
    ),
    Best = best(Cost, Choice),
    Choice \== none.
