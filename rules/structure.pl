:- module(structure,
          [ network/1,                  % -Network
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

All of the network is tables here: label/2, shape/2, unseen_shape/2,
needs/4, goes/4, trusted/3, never/2, worth/2, supports_label/2,
neutral_class/1. `reasoning/labelling.py` reads them once, by network/1,
and finds the cheapest labelling of planes. What it minimises is
labelling_cost/4. A rule file adds a label by more lines of the tables, as
`rules/optional/furniture_planes.pl` does:

    structure:label(table_top, 0.01).
    structure:shape(table_top, [one_of(facing, [up]), area >= 0.3]).
    structure:needs(table_top, above, floor,
                    [a(z_min)-b(z_max) >= 0.4, a(z_min)-b(z_max) =< 1.2]).
    structure:goes(_, table_top, _, []).
    structure:supports_label(table, table_top).

A plane is plane(Id, Facing, ZMin, ZMax, Width, Area, Evidence):

  - Facing is `up`, `down`, `side` or `oblique`;
  - ZMin and ZMax are heights [m], Width its horizontal extent [m],
    Area its covered area [m2];
  - Evidence is a list of Class-Share, the share of the plane's surface
    that carries each class label ([] where nothing is labelled), or
    given(Label) for a plane whose label is settled and only serves as
    context for the others.

Conditions are lists of comparisons of `z_min`, `z_max`, `height`, `width`,
`area`, of numbers and of the names of thresholds; and one_of(facing,
Facings). Of two planes, a(area) is the first one's and b(area) the
second's.

Example: a table top above a floor cannot be a floor as well.

    ?- labelling_cost([ plane(1, up, 0.0, 0.0, 4.0, 12.0, []),
                        plane(2, up, 0.7, 0.7, 1.2, 0.9, []) ],
                      [ relation(parallel, 2, 1), relation(above, 2, 1) ],
                      [1-floor, 2-no_feature], Cost).
    Cost = 0.4525.
*/

:- use_module(library(apply)).
:- use_module(library(lists)).
:- use_module(library(pairs)).
:- use_module(library(yall)).

:- multifile
    label/2, shape/2, unseen_shape/2, needs/4, goes/4, trusted/3, never/2, worth/2,
    supports_label/2, neutral_class/1.
:- discontiguous
    label/2, shape/2, unseen_shape/2, needs/4, goes/4, trusted/3, never/2, worth/2,
    supports_label/2, neutral_class/1.

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

% -- the labels ----------------------------------------------------------

%!  label(?Label, ?Cost) is nondet.
%
%   What a plane can be besides `no_feature`. Cost settles what nothing else
%   settles: a plane of a leaf's size that agrees with the directions of the
%   walls is a piece of wall, another a leaf.

label(wall, 0.02).
label(floor, 0.0).
label(ceiling, 0.0).
label(door, 0.01).

%!  shape(?Label, ?Conditions) is nondet.
%
%   What a plane with this Label is like, whatever else speaks for it.

shape(wall, [one_of(facing, [side]), width >= wall_width, area >= structure_area]).
shape(door, [one_of(facing, [side]), width >= wall_width, area >= structure_area]).
shape(floor, [one_of(facing, [up, oblique]), area >= structure_area]).
shape(ceiling, [one_of(facing, [down, oblique]), area >= structure_area]).

%!  unseen_shape(?Label, ?Conditions) is nondet.
%
%   … and where the label was not seen on it (evident_share/1).

unseen_shape(wall, [height >= wall_height]).
unseen_shape(door, [height >= leaf_height(low), height =< leaf_height(high),
                    width >= leaf_width(low), width =< leaf_width(high)]).
unseen_shape(floor, [one_of(facing, [up])]).
unseen_shape(ceiling, [one_of(facing, [down])]).

%!  needs(?Label, ?Relation, ?Other, ?Conditions) is nondet.
%
%   What is Label stands in this relation, under these conditions, to
%   something that may be Other, unless it was seen to be Label. A leaf needs
%   a floor to stand on.

needs(door, above, floor, [a(z_min)-b(z_max) =< leaf_floor_gap]).

%!  goes(?Relation, ?LabelA, ?LabelB, ?Conditions) is nondet.
%
%   The network: the labels of two planes that can stand in this relation,
%   under these conditions. A leaf ajar is neither parallel nor at right
%   angles to the walls about it: what is so without being labelled a door is
%   the side of a cupboard.

goes(parallel, wall, wall, []).
goes(parallel, door, door, []).
goes(parallel, floor, floor, []).
goes(parallel, floor, ceiling, []).
goes(parallel, ceiling, ceiling, []).
goes(orthogonal, wall, wall, []).
goes(orthogonal, wall, floor, []).
goes(orthogonal, wall, ceiling, []).
goes(orthogonal, door, floor, []).
goes(orthogonal, door, ceiling, []).
goes(equalheight, floor, floor, []).
goes(equalheight, ceiling, ceiling, []).
goes(equalheight, wall, wall, []).
goes(above, ceiling, floor, [a(z_min)-b(z_max) >= ceiling_clearance]).
goes(above, ceiling, wall, [a(z_min)-b(z_max) =< wall_ceiling_gap]).
goes(above, ceiling, door, []).
goes(above, wall, floor, [a(z_min)-b(z_max) =< wall_floor_gap]).
goes(above, door, floor, [a(z_min)-b(z_max) =< leaf_floor_gap]).

%!  trusted(?Relation, ?Label, ?Other) is nondet.
%
%   What was seen outweighs geometry: a plane that was seen to be Label can
%   stand in this relation to one that is Other. A leaf that was seen to be
%   one, a wall whose upper part was not seen. (Where both labels were seen,
%   no geometry confirms them.)

trusted(parallel, door, _).
trusted(orthogonal, door, _).
trusted(equalheight, door, _).
trusted(above, wall, floor).
trusted(under, wall, ceiling).

%!  never(?Relation, ?Label) is nondet.
%
%   A plane with this Label does not stand so to anything, not even to what is
%   `no_feature`. Uprights that meet in a corner and end at the same height are
%   a box, and no leaf.

never(equalheight, door).

%!  worth(?Conditions, ?Expression) is nondet.
%
%   How much speaks for a plane's being structure, from its shape alone: the
%   first line whose conditions hold. It is what no_feature costs, from
%   smallest_weight/1 up to largest_weight/1.

worth([one_of(facing, [up, down])], area*min(1.0, area/room_area)).
worth([height >= storey_height], area).
worth([], area*furniture_share).

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

% -- what one plane can be ----------------------------------------------

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
    label(Label, Prior),
    forall(shape(Label, Conditions), met(Conditions, Plane, none)),
    (   evident(Label, Shares)
    ->  true
    ;   forall(unseen_shape(Label, Conditions), met(Conditions, Plane, none))
    ),
    evidence_weight(Evidence),
    pairs_values(Shares, All),
    sum_list(All, Sum),
    (   memberchk(Label-Own, Shares)
    ->  true
    ;   Own = 0.0
    ),
    Cost is Prior + Evidence*(Against+Sum-Own).

weight(Plane, Weight) :-
    once(( worth(Conditions, Expression), met(Conditions, Plane, none) )),
    value(Expression, Plane, none, Worth),
    smallest_weight(Least),
    largest_weight(Most),
    Weight is min(Most, Least+Worth).

%   Shares: Label-Share for each label that classes on the plane support.
%   Against: the share of classes that are no structure.

shares(plane(_, _, _, _, _, _, Evidence), Shares, Against) :-
    findall(Label-Share, ( member(Class-Share, Evidence), supports_label(Class, Label) ), Pairs),
    keysort(Pairs, Sorted),
    group_pairs_by_key(Sorted, Groups),
    maplist([Label-Parts, Label-Sum]>>sum_list(Parts, Sum), Groups, Shares),
    findall(Share, ( member(Class-Share, Evidence), \+ supports_label(Class, _), \+ neutral_class(Class) ), Others),
    sum_list(Others, Against0),
    Against is min(1.0, Against0).

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

%   met(+Conditions, +PlaneA, +PlaneB): all of them hold.

met(Conditions, A, B) :-
    forall(member(Condition, Conditions), holds(Condition, A, B)).

holds(one_of(facing, Facings), plane(_, Facing, _, _, _, _, _), _) :-
    memberchk(Facing, Facings).
holds(X >= Y, A, B) :-
    values(X, Y, A, B, VX, VY),
    VX >= VY.
holds(X =< Y, A, B) :-
    values(X, Y, A, B, VX, VY),
    VX =< VY.

values(X, Y, A, B, VX, VY) :-
    value(X, A, B, VX),
    value(Y, A, B, VY).

value(X, _, _, X) :-
    number(X),
    !.
value(X, _, _, Value) :-
    threshold_value(X, Value),
    !.
value(a(X), A, _, Value) :-
    !,
    value(X, A, none, Value).
value(b(X), _, B, Value) :-
    !,
    value(X, B, none, Value).
value(Measure, A, _, Value) :-
    measure(Measure, A, Value),
    !.
value(Expression, A, B, Value) :-
    Expression =.. [Operator, X, Y],
    values(X, Y, A, B, VX, VY),
    Plain =.. [Operator, VX, VY],
    Value is Plain.

measure(z_min, plane(_, _, Z, _, _, _, _), Z).
measure(z_max, plane(_, _, _, Z, _, _, _), Z).
measure(height, plane(_, _, Low, High, _, _, _), Height) :-
    Height is High-Low.
measure(width, plane(_, _, _, _, Width, _, _), Width).
measure(area, plane(_, _, _, _, _, Area, _), Area).

% -- what two planes can be ----------------------------------------------

%!  allowed(+Relation, +PlaneA, ?LabelA, +PlaneB, ?LabelB) is semidet.
%
%   PlaneA and PlaneB, in this Relation, can have these labels. Labels that
%   are evident on both planes need no geometry to confirm them.

allowed(under, A, LabelA, B, LabelB) :-
    !,
    allowed(above, B, LabelB, A, LabelA).
allowed(Relation, A, LabelA, B, LabelB) :-
    (   forbidden(Relation, LabelA, LabelB)
    ->  exempt(Relation, A, LabelA, B, LabelB)
    ;   memberchk(no_feature, [LabelA, LabelB])
    ->  true
    ;   confirmed(Relation, A, LabelA, B, LabelB)
    ->  true
    ;   exempt(Relation, A, LabelA, B, LabelB)
    ).

forbidden(Relation, LabelA, _) :-
    never(Relation, LabelA),
    !.
forbidden(Relation, _, LabelB) :-
    converse(Relation, Converse),
    never(Converse, LabelB).

confirmed(Relation, A, LabelA, B, LabelB) :-
    goes(Relation, LabelA, LabelB, Conditions),
    met(Conditions, A, B).
confirmed(Relation, A, LabelA, B, LabelB) :-
    converse(Relation, Converse),
    goes(Converse, LabelB, LabelA, Conditions),
    met(Conditions, B, A).

exempt(_, A, LabelA, B, LabelB) :-
    evident_label(A, LabelA),
    evident_label(B, LabelB),
    !.
exempt(Relation, A, LabelA, _, LabelB) :-
    evident_label(A, LabelA),
    trusted(Relation, LabelA, LabelB),
    !.
exempt(Relation, _, LabelA, B, LabelB) :-
    evident_label(B, LabelB),
    converse(Relation, Converse),
    trusted(Converse, LabelB, LabelA),
    !.

%   converse(?Relation, ?Converse): the same, told of the second plane first.

converse(above, under) :- !.
converse(under, above) :- !.
converse(Relation, Relation).

%   What a label needs is there, or was not needed to see it.

grounded(Plane, Label, Planes, Relations) :-
    (   evident_label(Plane, Label)
    ->  true
    ;   forall(needs(Label, Relation, Other, Conditions),
               supplied(Plane, Relation, Other, Conditions, Planes, Relations))
    ).

supplied(Plane, Relation, Other, Conditions, Planes, Relations) :-
    arg(1, Plane, Id),
    converse(Relation, Converse),
    (   member(relation(Relation, Id, OtherId), Relations)
    ;   member(relation(Converse, OtherId, Id), Relations)
    ),
    member(Known, Planes),
    arg(1, Known, OtherId),
    met(Conditions, Plane, Known),
    label_cost(Known, Other, _),
    !.

% -- what is minimised ---------------------------------------------------

%!  labelling_cost(+Planes, +Relations, +Labels, -Cost) is semidet.
%
%   Labels, a list of Id-Label, is consistent and costs Cost. Relations is a
%   list of relation(Name, IdA, IdB).

labelling_cost(Planes, Relations, Labels, Cost) :-
    costs(Planes, Labels, 0.0, Cost),
    forall(( member(Plane, Planes), arg(1, Plane, Id), memberchk(Id-Label, Labels) ),
           grounded(Plane, Label, Planes, Relations)),
    forall(member(relation(Relation, A, B), Relations),
           ( plane_and_label(A, Planes, Labels, PlaneA, LabelA),
             plane_and_label(B, Planes, Labels, PlaneB, LabelB),
             allowed(Relation, PlaneA, LabelA, PlaneB, LabelB)
           )).

plane_and_label(Id, Planes, Labels, Plane, Label) :-
    Plane = plane(Id, _, _, _, _, _, _),
    once(member(Plane, Planes)),
    memberchk(Id-Label, Labels).

costs([], _, Cost, Cost).
costs([Plane|Planes], Labels, Cost0, Cost) :-
    arg(1, Plane, Id),
    memberchk(Id-Label, Labels),
    label_cost(Plane, Label, C),
    !,
    Cost1 is Cost0+C,
    costs(Planes, Labels, Cost1, Cost).

% -- reading the tables --------------------------------------------------

%!  network(-Network) is det.
%
%   All tables, with numbers in the place of names, as
%
%       network(numbers(EvidentShare, EvidenceWeight, Smallest, Largest),
%               Labels, Shapes, Unseen, Needs, Goes, Trusted, Never, Worth,
%               Supports, Neutral)
%
%   where each but the first is a list of lines, such as goes(above, wall,
%   floor, [a(z_min)-b(z_max) =< 1.6]).

network(network(numbers(Share, Evidence, Least, Most),
                Labels, Shapes, Unseen, Needs, Goes, Trusted, Never, Worth, Supports, Neutral)) :-
    evident_share(Share),
    evidence_weight(Evidence),
    smallest_weight(Least),
    largest_weight(Most),
    findall(label(L, C), label(L, C), Labels),
    findall(shape(L, C), ( shape(L, C0), plain(C0, C) ), Shapes),
    findall(unseen_shape(L, C), ( unseen_shape(L, C0), plain(C0, C) ), Unseen),
    findall(needs(L, R, O, C), ( needs(L, R, O, C0), plain(C0, C) ), Needs),
    findall(goes(R, L, O, C), ( goes(R, L, O, C0), plain(C0, C) ), Goes),
    findall(trusted(R, L, O), trusted(R, L, O), Trusted),
    findall(never(R, L), never(R, L), Never),
    findall(worth(C, E), ( worth(C0, E0), plain(C0, C), plain(E0, E) ), Worth),
    findall(supports_label(C, L), supports_label(C, L), Supports),
    findall(neutral_class(C), neutral_class(C), Neutral).

%   plain(+Term, -Plain): numbers in the place of the names of thresholds.

plain(Term, Plain) :-
    (   var(Term)
    ->  Plain = Term
    ;   threshold_value(Term, Value)
    ->  Plain = Value
    ;   compound(Term)
    ->  mapargs(plain, Term, Plain)
    ;   Plain = Term
    ).

%   threshold_value(+Name, -Value): of wall_width, or of leaf_width(low).

threshold_value(Name, Value) :-
    atom(Name),
    current_predicate(Name/1),
    call(Name, Value).
threshold_value(Range, Value) :-
    compound(Range),
    Range =.. [Name, End],
    nth_end(End, Low, High, Value),
    call(Name, Low, High).

nth_end(low, Low, _, Low).
nth_end(high, _, High, High).

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

