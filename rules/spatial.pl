:- module(spatial,
          [ judged/5,                   % +Relation, ?A, ?B, -Truth, -Tests
            holds/3,                    % +Relation, ?A, ?B
            possibly_holds/3,           % +Relation, ?A, ?B
            inverse/2,                  % ?Relation, ?Inverse
            symmetric/1,                % ?Relation
            one_way/1,                  % ?Relation
            on_demand/1,                % ?Relation
            room_of/3,                  % +Thing, -Room, -Tests
            stands_on/2,                % +Thing, -Support
            near_distance/3,            % +A, +B, -Metres
            contact_gap/1,              % -Metres
            robot_width/2,              % +Robot, -Metres
            derived_edge/6,             % ?Relation, ?A, ?B, -Value, -Threshold, -Confidence
            derived_edges_of/2,         % +Ids, -Edges
            affected_by/2,              % +Ids, -Affected
            affected_edges/3,           % +Ids, -Affected, -Edges
            threshold/4,                % ?Name, -Value, ?Unit, ?Reason
            override/1                  % +Threshold
          ]).
:- use_module(library(lists)).
:- use_module(library(ordsets)).
:- use_module(library(error)).
:- use_module(facts).
:- use_module(taxonomy, [part_kind/2, subclass/2]).

/** <module> Spatial relations, derived from measurements

Python measures, these rules decide. Each relation has one definition, in
judged/5: the tests that its measurements must pass, in three truth values. What
holds, what may hold, the stored edges, and every explanation come from there.

The canonical relations with an inverse are `on`, `in` and `above`; `near`,
`next_to` and `touching` are symmetric; `attached_to`, `hanging_from` and
`part_of` go one way. `visible_from`, `reachable` and `blocks` are measured when
somebody asks, and never stored.

Example: a cup 2 mm above a table top, with 90 % of its foot over the table:

    ?- judged(on, cup_1, table_1, Truth, Tests).
    Truth = true,
    Tests = [ test(contact, 0.9, >=, contact_share, 0.2),
              test(lowest_above, 0.73, >, nothing, 0) ].
*/

                /*******************************
                *          THRESHOLDS          *
                *******************************/

:- dynamic
    contact_share/1, contact_margin/1, overlap_share/1, footing_inside_share/1, voxels_inside_share/1,
    room_share/1, own_room_share/1, near_least/1, near_most/1, side_share/1, clear_share/1, visible_share/1.

contact_share(0.2).
contact_margin(0.03).
overlap_share(0.2).
footing_inside_share(0.8).
voxels_inside_share(0.3).
room_share(0.5).
own_room_share(0.8).
near_least(0.5).
near_most(1.5).
side_share(0.2).
clear_share(0.5).
visible_share(0.05).

%!  threshold(?Name, -Value, ?Unit, ?Reason) is nondet.
%
%   The thresholds that a rule file may replace, with override/1.

threshold(Name, Value, Unit, Reason) :-
    threshold_reason(Name, Unit, Reason),
    Threshold =.. [Name, Value],
    call(Threshold).

threshold_reason(contact_share, share,
    "a fifth of a footing carries a thing: a chair with one of its four legs on a rug still stands on it").
threshold_reason(contact_margin, metre,
    "depth noise of a few millimetres and thin cloths; one voxel is added, since surfaces are known no better").
threshold_reason(overlap_share, share,
    "less than a fifth of the smaller footprint is a corner reaching over, not being above").
threshold_reason(footing_inside_share, share,
    "a thing that is in a container has its foot in it, up to a voxel at the rim").
threshold_reason(voxels_inside_share, share,
    "a bottle in a basket sticks out of it by more than half and is still in it").
threshold_reason(room_share, share,
    "a thing belongs to the room that holds at least half of its footprint").
threshold_reason(own_room_share, share,
    "a thing that straddles a border goes with what it stands on").
threshold_reason(near_least, metre,
    "small things: within arm's reach of each other").
threshold_reason(near_most, metre,
    "large things: a step and a half away; farther is across the room").
threshold_reason(side_share, share,
    "a picture leans on its nail and lower edge, a wall lamp stands off on its arm: a fifth of the side is fixed").
threshold_reason(clear_share, share,
    "where half of the space below a thing was seen to be free nothing there carries it; where less was, something may").
threshold_reason(visible_share, share,
    "a twentieth of the surface that could be seen at all shows what a thing is; less is a glimpse between others").

%!  override(+Threshold) is det.
%
%   Replace a threshold, from a rule file: `:- override(contact_share(0.3)).`
%
%   @error existence_error(threshold, Name), type_error(number, Value)

override(Threshold) :-
    must_be(compound, Threshold),
    Threshold =.. [Name, Value],
    (   threshold_reason(Name, _, _)
    ->  true
    ;   existence_error(threshold, Name)
    ),
    must_be(number, Value),
    must_be(nonneg_number, Value),
    Old =.. [Name, _],
    retractall(Old),
    assertz(Threshold).

:- multifile error:has_type/2.
error:has_type(nonneg_number, Value) :- number(Value), Value >= 0.

%!  contact_gap(-Metres) is det.
%
%   Things closer than this touch: contact_margin/1 and one voxel.

contact_gap(Gap) :-
    contact_margin(Margin),
    (   parameter(voxel_size_m, Voxel)
    ->  Gap is Margin+Voxel
    ;   Gap = Margin
    ).

%!  near_distance(+A, +B, -Metres) is semidet.
%
%   Half the sum of the longer sides of the two footprints, clamped to
%   near_least/1 .. near_most/1: near a cup is nearer than near a sofa.

near_distance(A, B, Distance) :-
    longer_side(A, SideA),
    longer_side(B, SideB),
    near_least(Least),
    near_most(Most),
    Distance is min(Most, max(Least, (SideA+SideB)/2)).

longer_side(A, Side) :-
    measured(longer_side, A, Side0),
    number(Side0),
    !,
    Side = Side0.
longer_side(A, Side) :-
    size(A, X, Y, _),
    !,
    Side is max(X, Y).
longer_side(_, 0.0).                    % an agent or a place: a point

                /*******************************
                *          RELATIONS           *
                *******************************/

%!  inverse(?Relation, ?Inverse) is nondet.
%
%   Relation(A,B) and Inverse(B,A) say the same; Relation is the canonical one.

inverse(on, supports).
inverse(in, contains).
inverse(above, under).

%!  symmetric(?Relation) is nondet.

symmetric(near).
symmetric(next_to).
symmetric(touching).

%!  one_way(?Relation) is nondet.
%
%   Stored as it is: nobody asks for the other direction by a name of its own.

one_way(attached_to).
one_way(hanging_from).
one_way(part_of).

%!  on_demand(?Relation) is nondet.
%
%   Depends on a robot or a viewer, or costs a look at the map: measured when it
%   is asked for and never stored.

on_demand(visible_from).
on_demand(reachable).
on_demand(blocks).

%!  judged(+Relation, ?A, ?B, -Truth, -Tests) is nondet.
%
%   Truth (`true`, `false` or `unknown`) of the canonical Relation for every
%   measured pair, and the Tests that decided, the leading one first. A test is
%   test(Measurement, Value, Comparison, ThresholdName, Threshold).

judged(on, A, B, Truth, [test(contact, Share, >=, contact_share, Enough)|More]) :-
    measured(contact, A, B, Share),
    A \== B,
    contact_share(Enough),
    at_least(Share, Enough, Enough_),
    (   Enough_ == false
    ->  Truth = false,
        More = []
    ;   structure_below(A, B, Order)
    ->  both(Enough_, Order, Truth),
        More = []
    ;   More = [test(lowest_above, Rise, >, nothing, 0)],
        lowest_above(A, B, Rise),
        higher(Rise, A, B, Order),
        both(Enough_, Order, Truth)
    ).
judged(in, A, B, Truth, [ test(footing_inside, Footing, >=, footing_inside_share, EnoughFooting),
                          test(voxels_inside, Voxels, >=, voxels_inside_share, EnoughVoxels) ]) :-
    measured(footing_inside, A, B, Footing),
    A \== B,
    ( measured(voxels_inside, A, B, Voxels) -> true ; Voxels = unknown ),
    footing_inside_share(EnoughFooting),
    voxels_inside_share(EnoughVoxels),
    at_least(Footing, EnoughFooting, Truth1),
    at_least(Voxels, EnoughVoxels, Truth2),
    both(Truth1, Truth2, Truth).
judged(in, A, Room, Truth, Tests) :-
    judged_room(A, Room, Truth, Tests).
judged(above, A, B, Truth, [ test(rise, Rise, >, contact_gap, Gap),
                             test(footprint_overlap, Overlap, >=, overlap_share, Enough) | More ]) :-
    mutual(footprint_overlap, A, B, Overlap),
    overlap_share(Enough),
    at_least(Overlap, Enough, Truth1),
    Truth1 \== false,
    measured(rise, A, B, Rise),
    contact_gap(Gap),
    more_than(Rise, Gap, Truth2),
    both(Truth1, Truth2, Truth3),
    (   Truth3 == false
    ->  Truth = false,
        More = []
    ;   More = [test(structure_between, Between, =<, nothing, 0), test(same_storey, Storey, >=, nothing, 1)],
        either_way(structure_between, A, B, 0, Between),
        at_most(Between, 0, Truth4),
        either_way(same_storey, A, B, 1, Storey),
        at_least(Storey, 1, Truth5),
        both(Truth3, Truth4, Truth6),
        both(Truth6, Truth5, Truth7),
        (   Truth7 \== false,
            judged(on, A, B, Resting, _)
        ->  negated(Resting, NotOn),
            both(Truth7, NotOn, Truth)
        ;   Truth = Truth7
        )
    ).
judged(near, A, B, Truth, [test(path_gap_upper, Upper, =<, near_distance, Distance)|More]) :-
    mutual(path_gap_upper, A, B, Upper),
    near_distance(A, B, Distance),
    at_most(Upper, Distance, Reached),
    (   Reached == true
    ->  Truth = true,
        More = []
    ;   ( mutual(path_gap_lower, A, B, Lower0) -> Lower = Lower0 ; Lower = unknown ),
        More = [test(path_gap_lower, Lower, =<, near_distance, Distance)],
        at_most(Lower, Distance, Reachable),
        ( Reachable == false -> Truth = false ; Truth = unknown )
    ).
judged(touching, A, B, Truth, Tests) :-
    mutual(gap, A, B, Gap),
    contact_gap(Enough),
    at_most(Gap, Enough, Close),
    (   Close \== true,
        ( footing_in_contact(A, B, Test) ; surface_below(A, B, Enough, Test) )
    ->  Truth = true,
        Tests = [Test]
    ;   Truth = Close,
        Tests = [test(gap, Gap, =<, contact_gap, Enough)]
    ).

judged(next_to, A, B, Truth, Tests) :-
    judged(near, A, B, Near, [NearTest|_]),
    beside(Near, NearTest, A, B, Truth, Tests).
judged(attached_to, A, B, Truth, [ test(side_contact, Share, >=, side_share, Enough),
                                   test(footing_contact, Footing, <, contact_share, Firm),
                                   test(clear_below, Clear, >=, clear_share, Open) ]) :-
    measured(side_contact, A, B, Share),
    side_share(Enough),
    at_least(Share, Enough, Truth1),
    stands_on_nothing(A, B, Footing, Firm, Clear, Open, Truth2),
    both(Truth1, Truth2, Truth).
judged(hanging_from, A, B, Truth, [ test(top_contact, Share, >=, contact_share, Enough),
                                    test(footing_contact, Footing, <, contact_share, Enough),
                                    test(clear_below, Clear, >=, clear_share, Open) ]) :-
    measured(top_contact, A, B, Share),
    contact_share(Enough),
    at_least(Share, Enough, Truth1),
    stands_on_nothing(A, B, Footing, Enough, Clear, Open, Truth2),
    both(Truth1, Truth2, Truth).
judged(part_of, A, B, Truth, Tests) :-
    part_and_whole(A, B),
    (   judged(in, A, B, true, Tests0)
    ->  Truth = true,
        Tests = Tests0
    ;   judged(touching, A, B, Truth, Tests)
    ).
judged(visible_from, A, P, Truth, [test(visible, Seen, >=, visible_share, Enough)|More]) :-
    measured(visible, A, P, Seen),
    visible_share(Enough),
    at_least(Seen, Enough, Clear),
    (   Clear == true
    ->  Truth = true,
        More = []
    ;   ( measured(possibly_visible, A, P, Open) -> true ; Open = unknown ),
        More = [test(possibly_visible, Open, >=, visible_share, Enough)],
        at_least(Open, Enough, Possible),
        ( Possible == false -> Truth = false ; Truth = unknown )
    ).
judged(reachable, A, Robot, Truth, [test(way_upper, Upper, <, no_way, Never)|More]) :-
    measured(way_upper, A, Robot, Upper),
    no_way(Never),
    less_than(Upper, Never, Known),
    (   Known == true
    ->  Truth = true,
        More = []
    ;   ( measured(way_lower, A, Robot, Lower) -> true ; Lower = unknown ),
        More = [test(way_lower, Lower, <, no_way, Never)],
        less_than(Lower, Never, Possible),
        ( Possible == false -> Truth = false ; Truth = unknown )
    ).
judged(blocks, A, Door, Truth, [test(clear_width, Width, <, robot_width, Needed)]) :-
    measured(clear_width, A, Door, Width),
    robot_width(_, Needed),
    less_than(Width, Needed, Truth).

%   footing_in_contact(+A, +B, -Test): one rests on the other, where the surfaces between were not seen.
footing_in_contact(A, B, test(contact, Share, >=, contact_share, Enough)) :-
    contact_share(Enough),
    number_or(contact, A, B, -1, ShareA),
    number_or(contact, B, A, -1, ShareB),
    Share is max(ShareA, ShareB),
    Share >= Enough.

%   surface_below(+A, +B, +Gap, -Test): the surface of one goes on, unseen, close below the other.
surface_below(A, B, Enough, test(drop, Drop, =<, contact_gap, Enough)) :-
    no_way(Never),
    number_or(drop, A, B, Never, DropA),
    number_or(drop, B, A, Never, DropB),
    Drop is min(DropA, DropB),
    Drop =< Enough.

%   number_or(+Name, +A, +B, +Default, -Value): what was measured of the pair, where it is a number.
number_or(Name, A, B, Default, Value) :-
    (   measured(Name, A, B, Known),
        number(Known)
    ->  Value = Known
    ;   Value = Default
    ).

%   beside(+Near, +NearTest, +A, +B, -Truth, -Tests): two things that are near, are they next to each other?
beside(false, NearTest, _, _, Truth, [NearTest]) :- !, Truth = false.
beside(Near, NearTest, A, B, Truth, Tests) :-
    shared_support(A, B, Support, Same),
    (   Same == false
    ->  Truth = false,
        Tests = [NearTest, test(same_support, none, =, nothing, shared)]
    ;   Tests = [NearTest, test(same_support, Support, =, nothing, Support), test(things_between, Between, =<, nothing, 0)],
        ( mutual(things_between, A, B, Between0) -> Between = Between0 ; Between = 0 ),
        at_most(Between, 0, Free),
        both(Near, Same, Truth1),
        both(Truth1, Free, Truth)
    ).

%   shared_support(+A, +B, -Support, -Truth): what carries both; unknown where a contact is.
shared_support(A, B, Support, true) :-
    judged(on, A, Support, true, _),
    judged(on, B, Support, true, _),
    !.
shared_support(A, B, Floor, true) :-
    judged(on, A, Floor, true, _),
    label(Floor, floor),
    judged(on, B, Other, true, _),
    label(Other, floor),
    position(Floor, _, _, Z),
    position(Other, _, _, OtherZ),
    same_floor(Most),
    abs(Z-OtherZ) =< Most,
    !.
shared_support(A, B, Support, unknown) :-
    judged(on, A, Support, TruthA, _),
    TruthA \== false,
    judged(on, B, Support, TruthB, _),
    TruthB \== false,
    !.
shared_support(_, _, none, false).

%   A floor is mapped as several planes where furniture or a doorway parts it; this far apart in height [m] they are one.
same_floor(0.1).

%   stands_on_nothing(+A, +B, -Footing, -Enough, -Clear, -Open, -Truth): A, which B holds, has no footing contact, of
%   which Footing is the largest share; known only where the space below it was seen to be free (Clear).
stands_on_nothing(A, B, Footing, Enough, Clear, Open, Truth) :-
    contact_share(Enough),
    findall(Share, measured(contact, A, _, Share), Shares),
    (   memberchk(unknown, Shares)
    ->  Footing = unknown
    ;   max_list([0|Shares], Footing)
    ),
    less_than(Footing, Enough, Truth1),
    clear_share(Open),
    ( measured(clear_below, A, B, Clear0) -> Clear = Clear0 ; Clear = unknown ),
    at_least(Clear, Open, Seen),
    ( Seen == true -> Truth2 = true ; Truth2 = unknown ),
    both(Truth1, Truth2, Truth).

%   part_and_whole(?A, ?B): the taxonomy says that a thing like A is part of a thing like B, and they are close.
part_and_whole(A, B) :-
    nonvar(A),
    !,
    label(A, Part),
    \+ \+ part_of_kind(Part, _),
    mutual(gap, A, B, _),
    label(B, Whole),
    \+ \+ ( part_of_kind(Part, Kind), subclass(Whole, Kind) ).
part_and_whole(A, B) :-
    (   nonvar(B)
    ->  label(B, Whole),
        setof(P, Kind^( subclass(Whole, Kind), part_kind(P, Kind) ), Parts)
    ;   setof(P, Kind^part_kind(P, Kind), Parts)
    ),
    setof(Thing, P^L^( member(P, Parts), subclass(L, P), label(Thing, L) ), Things),
    member(A, Things),
    part_and_whole(A, B).

part_of_kind(Label, Kind) :-
    subclass(Label, Part),
    part_kind(Part, Kind).

%!  robot_width(+Robot, -Metres) is det.
%
%   How wide an opening the robot needs; with an unknown robot, the one in
%   question: the only one that described itself, else the default of the map.

robot_width(Robot, Width) :-
    nonvar(Robot),
    attribute(Robot, width_m, Width),
    number(Width),
    !.
robot_width(Robot, Width) :-
    var(Robot),
    findall(W, ( node(Id, agent), attribute(Id, width_m, W) ), [Width]),
    !.
robot_width(_, Width) :-
    parameter(robot_width_m, Width),
    !.
robot_width(_, 0.5).

%   A way this long is none.
no_way(1.0e9).

%   Structure lies below everything, and rests on nothing.
structure_below(A, _, Truth) :-
    node(A, structure),
    !,
    Truth = false.
structure_below(_, B, true) :-
    node(B, structure).

lowest_above(A, B, Rise) :-
    measured(lowest, A, LowestA),
    measured(lowest, B, LowestB),
    !,
    ( number(LowestA), number(LowestB) -> Rise is LowestA-LowestB ; Rise = unknown ).
lowest_above(A, B, Rise) :-
    measured(lowest_above, A, B, Rise), !.
lowest_above(A, B, Rise) :-
    position(A, _, _, ZA), size(A, _, _, HA),
    position(B, _, _, ZB), size(B, _, _, HB),
    !,
    Rise is (ZA-HA/2)-(ZB-HB/2).
lowest_above(_, _, unknown).

higher(unknown, _, _, Truth) :- !, Truth = unknown.
higher(Rise, _, _, Truth) :- Rise > 0, !, Truth = true.
higher(Rise, A, B, Truth) :- Rise =:= 0, A @> B, !, Truth = true.
higher(_, _, _, false).

either_way(Name, A, B, Default, Value) :-
    (   measured(Name, A, B, Value0)
    ->  Value = Value0
    ;   measured(Name, B, A, Value0)
    ->  Value = Value0
    ;   Value = Default
    ).

                /*******************************
                *            ROOMS             *
                *******************************/

%!  room_of(+Thing, -Room, -Tests) is semidet.
%
%   The room with the largest share of Thing's footprint, at least room_share/1.
%   What stands on an object and has less than own_room_share/1 of its own in
%   one room goes with that object.

room_of(Thing, Room, Tests) :-
    (   own_room(Thing, Own, Share)
    ->  true
    ;   Share = 0
    ),
    own_room_share(Clear),
    (   Share < Clear,
        stands_on(Thing, Support),
        room_of(Support, SupportRoom, [Test|_])
    ->  Room = SupportRoom,
        Tests = [Test, test(stands_on, Support, =, nothing, Support)]
    ;   room_share(Enough),
        Share >= Enough,
        Room = Own,
        Tests = [test(footprint_share, Share, >=, room_share, Enough)]
    ).

own_room(Thing, Room, Share) :-
    findall(Negative-R,
            ( measured(footprint_share, Thing, R, S), number(S), Negative is -S ),
            Shares),
    keysort_by_room(Shares, [Least-Room|_]),
    Share is -Least.

keysort_by_room([One], [One]) :- !.
keysort_by_room(Shares, Sorted) :-
    msort(Shares, Sorted).

%!  stands_on(+Thing, -Support) is semidet.
%
%   The object that carries most of Thing's footing.

stands_on(Thing, Support) :-
    findall(Negative-B,
            ( judged(on, Thing, B, true, [test(_, Share, _, _, _)|_]),
              \+ node(B, structure),
              Negative is -Share ),
            Supports),
    msort(Supports, [_-Support|_]).

judged_room(A, Room, Truth, Tests) :-
    nonvar(A),
    !,
    (   room_of(A, Its, ItsTests),
        Room = Its,
        Truth0 = true,
        Tests0 = ItsTests
    ->  Truth = Truth0,
        Tests = Tests0
    ;   room_share(Enough),
        measured(footprint_share, A, Room, Share),
        ( Share == unknown -> Truth = unknown ; Truth = false ),
        Tests = [test(footprint_share, Share, >=, room_share, Enough)]
    ).
judged_room(A, Room, Truth, Tests) :-
    nonvar(Room),
    !,
    findall(Thing, candidate(Room, Thing), Things0),
    sort(Things0, Things),
    member(A, Things),
    judged_room(A, Room, Truth, Tests).
judged_room(A, Room, Truth, Tests) :-
    findall(Thing, candidate(_, Thing), Things0),
    sort(Things0, Things),
    member(A, Things),
    judged_room(A, Room, Truth, Tests).

%   A thing that may be in Room: part of it is, or what it stands on may be.
candidate(Room, Thing) :-
    measured(footprint_share, Below, Room, _),
    rests_upon(Thing, Below).

rests_upon(Thing, Thing).
rests_upon(Thing, Below) :-
    measured(contact, Next, Below, _),
    \+ node(Below, structure),
    judged(on, Next, Below, true, _),
    rests_upon(Thing, Next).

                /*******************************
                *         TRUTH VALUES         *
                *******************************/

%!  holds(+Relation, ?A, ?B) is nondet.
%
%   True when Relation(A,B) is certain, derived or stored.

holds(Relation, A, B) :-
    reading(Relation, A, B, Canonical, X, Y),
    judged(Canonical, X, Y, true, _).
holds(Relation, A, B) :-
    edge(Relation, A, B, _, _, _).

%!  possibly_holds(+Relation, ?A, ?B) is nondet.
%
%   True when Relation(A,B) is not known to be false for a measured pair.

possibly_holds(Relation, A, B) :-
    reading(Relation, A, B, Canonical, X, Y),
    judged(Canonical, X, Y, Truth, _),
    Truth \== false.
possibly_holds(Relation, A, B) :-
    edge(Relation, A, B, _, _, _).

%   reading(+Relation, ?A, ?B, -Canonical, ?X, ?Y): the canonical relation that says the same.

reading(Relation, A, B, Canonical, B, A) :-
    inverse(Canonical, Relation),
    !.
reading(Relation, A, B, Relation, A, B).

%   The output comes after the cut: these are also called with the truth that is wanted.

at_least(unknown, _, Truth) :- !, Truth = unknown.
at_least(Value, Threshold, Truth) :- Value >= Threshold, !, Truth = true.
at_least(_, _, false).

at_most(unknown, _, Truth) :- !, Truth = unknown.
at_most(Value, Threshold, Truth) :- Value =< Threshold, !, Truth = true.
at_most(_, _, false).

less_than(unknown, _, Truth) :- !, Truth = unknown.
less_than(Value, Threshold, Truth) :- Value < Threshold, !, Truth = true.
less_than(_, _, false).

more_than(unknown, _, Truth) :- !, Truth = unknown.
more_than(Value, Threshold, Truth) :- Value > Threshold, !, Truth = true.
more_than(_, _, false).

both(false, _, Truth) :- !, Truth = false.
both(_, false, Truth) :- !, Truth = false.
both(true, true, Truth) :- !, Truth = true.
both(_, _, unknown).

negated(true, false).
negated(false, true).
negated(unknown, unknown).

                /*******************************
                *            EDGES             *
                *******************************/

%!  derived_edge(?Relation, ?A, ?B, -Value, -Threshold, -Confidence) is nondet.
%
%   Every edge that these rules derive, in both directions: the value that was
%   compared, the threshold, and a confidence of 0.5 at the threshold that grows
%   to 1 with the margin.

derived_edge(Relation, A, B, Value, Threshold, Confidence) :-
    nonvar(Relation),
    !,
    reading(Relation, A, B, Canonical, X, Y),
    canonical_edge(Canonical, X, Y, Value, Threshold, Confidence).
derived_edge(Relation, A, B, Value, Threshold, Confidence) :-
    (   symmetric(Relation)
    ;   one_way(Relation)
    ;   inverse(Relation, _)
    ;   inverse(_, Relation)
    ),
    derived_edge(Relation, A, B, Value, Threshold, Confidence).

canonical_edge(Relation, A, B, Value, Threshold, Confidence) :-
    judged(Relation, A, B, true, Tests),
    graded_edge(Relation, A, Tests, Value, Threshold, Confidence).

graded_edge(Relation, A, Tests, Value, Threshold, Confidence) :-
    Tests = [test(_, Value, _, _, Threshold)|_],
    certainty(Tests, 1.0, Margin),
    footing_certainty(Relation, A, Margin, Confidence).

%   The weakest margin decides. A margin is full at its scale: a share's way to 1, a distance's third.
certainty([], Confidence, Confidence).
certainty([test(_, Value, Comparison, _, Threshold)|Tests], Least, Confidence) :-
    (   margin(Comparison, Value, Threshold, Margin)
    ->  Next is min(Least, 0.5+0.5*min(1.0, Margin))
    ;   Next = Least
    ),
    certainty(Tests, Next, Confidence).

margin(>=, Value, Threshold, Margin) :-
    number(Value), Threshold < 1, Margin is (Value-Threshold)/(1-Threshold).
margin(=<, Value, Threshold, Margin) :-
    number(Value), Threshold > 0, Margin is 3*(Threshold-Value)/Threshold.
margin(<, Value, Threshold, Margin) :-
    number(Value), Threshold > 0, Margin is (Threshold-Value)/Threshold.
margin(>, Value, Threshold, Margin) :-
    number(Value), Threshold > 0, Margin is (Value-Threshold)/Threshold.

%   A footing that was completed, not seen, halves what is beyond doubt.
footing_certainty(on, A, Margin, Confidence) :-
    measured(footing_seen, A, Seen),
    number(Seen),
    !,
    Confidence is 0.5+(Margin-0.5)*(0.5+0.5*Seen).
footing_certainty(_, _, Confidence, Confidence).

%!  derived_edges_of(+Ids:list, -Edges:list) is det.
%
%   Edges is every derived edge, as edge(Relation, A, B, Value, Threshold,
%   Confidence), that begins or ends at one of Ids, in both directions and
%   without duplicates.

derived_edges_of(Ids, Edges) :-
    canonical_edges_of(Ids, Canonical),
    findall(Edge, ( member(Pair, Canonical), either_direction(Pair, Edge) ), Edges0),
    sort(Edges0, Edges).

either_direction(pair(Relation, _, A, B, V, T, C), edge(Relation, A, B, V, T, C)).
either_direction(pair(_, Inverse, A, B, V, T, C), edge(Inverse, B, A, V, T, C)) :-
    Inverse \== none.

%   canonical_edges_of(+Ids, -Pairs): each pair once, as pair(Relation, Inverse, A, B, Value, Threshold, Confidence);
%   Inverse is none for a relation that goes one way.
canonical_edges_of(Ids0, Pairs) :-
    sort(Ids0, Ids),
    findall(Pair, ( member(Id, Ids), pair_at(Id, Ids, Pair) ), Pairs0),
    sort(Pairs0, Pairs).

pair_at(Id, _, pair(Relation, Inverse, Id, B, Value, Threshold, Confidence)) :-
    ( inverse(Relation, Inverse) ; one_way(Relation), Inverse = none ),
    canonical_edge(Relation, Id, B, Value, Threshold, Confidence).
pair_at(Id, Ids, pair(Relation, Inverse, A, Id, Value, Threshold, Confidence)) :-
    ( inverse(Relation, Inverse) ; one_way(Relation), Inverse = none ),
    canonical_edge(Relation, A, Id, Value, Threshold, Confidence),
    \+ ord_memberchk(A, Ids).
pair_at(Id, Ids, pair(Relation, Relation, A, B, Value, Threshold, Confidence)) :-
    partners(Id, Ids, Relation, Other, Tests),
    graded_edge(Relation, Id, Tests, Value, Threshold, Confidence),
    ( Id @< Other -> A = Id, B = Other ; A = Other, B = Id ).

%   partners(+Id, +Ids, -Relation, -Other, -Tests): symmetric relations of Id, those to an earlier one of Ids left out;
%   what is next to something is near it, and found with it.
partners(Id, Ids, Relation, Other, Tests) :-
    findall(Support, judged(on, Id, Support, true, _), Supports),
    mutual(path_gap_upper, Id, Other, _),
    \+ ( Other @< Id, ord_memberchk(Other, Ids) ),
    judged(near, Id, Other, true, NearTests),
    (   Relation = near,
        Tests = NearTests
    ;   \+ \+ ( member(Support, Supports), ( measured(contact, Other, Support, _) ; label(Support, floor) ) ),
        NearTests = [NearTest|_],
        beside(true, NearTest, Id, Other, true, Tests),
        Relation = next_to
    ).
partners(Id, Ids, touching, Other, Tests) :-
    mutual(gap, Id, Other, _),
    \+ ( Other @< Id, ord_memberchk(Other, Ids) ),
    judged(touching, Id, Other, true, Tests).

%!  affected_by(+Ids:list, -Affected:list) is det.
%
%   Affected is Ids and everything that stands on one of them, directly or not:
%   the things whose derived edges may change when Ids were measured anew.

affected_by(Ids, Affected) :-
    findall(Thing, ( member(Id, Ids), rests_upon(Thing, Id) ), Things),
    sort(Things, Affected).

%!  affected_edges(+Ids:list, -Affected:list, -Text:string) is det.
%
%   affected_by/2 and the derived edges of that, each pair once, as a line of
%   words: relation, inverse, ids, value, threshold, confidence. What the graph
%   asks after each observation; a text is read a good deal faster than terms.

affected_edges(Ids, Affected, Text) :-
    affected_by(Ids, Affected),
    canonical_edges_of(Affected, Pairs),
    with_output_to(string(Text),
                   forall(member(pair(Relation, Inverse, A, B, Value, Threshold, Confidence), Pairs),
                          format("~w ~w ~w ~w ~w ~w ~w~n",
                                 [Relation, Inverse, A, B, Value, Threshold, Confidence]))).
