:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(affordances)).
:- use_module(rules(taxonomy)).
:- use_module(rules(viewpoint)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

home([ node(cup_1, object), label(cup_1, cup), size(cup_1, 0.08, 0.11, 0.1),
       node(cup_2, object), label(cup_2, mug),
       node(gizmo_1, object), label(gizmo_1, gizmo), size(gizmo_1, 0.5, 0.5, 0.5),
       node(chair_1, object), label(chair_1, office_chair), size(chair_1, 0.5, 0.5, 0.9),
       node(fridge_1, object), label(fridge_1, fridge), size(fridge_1, 0.6, 0.6, 1.8),
       node(basket_1, object), label(basket_1, laundry_basket), size(basket_1, 0.4, 0.4, 0.5),
       node(piano_1, object), label(piano_1, piano), size(piano_1, 1.5, 0.6, 1.2),
       node(door_1, structure), label(door_1, door), size(door_1, 0.9, 0.05, 2.0),
       node(floor_1, structure), label(floor_1, floor),
       node(room_1, room), node(room_2, room),
       edge(connects, door_1, room_1, 0.8, none, 1.0), edge(connects, door_1, room_2, 0.8, none, 1.0),
       edge(connects, gap_1, room_1, none, none, 1.0),
       node(agent_rob, agent), label(agent_rob, robot), attribute(agent_rob, width_m, 0.5) ]).

offered(Word, Ids) :-
    findall(Id, affords(Word, Id, true, _), Ids0),
    sort(Ids0, Ids).

:- begin_tests(affordances, [setup(( home(Facts), with(Facts), set_viewer(none) ))]).

test(containers, true(Ids == [basket_1, cup_1, cup_2, fridge_1])) :- offered(container, Ids).
test(openable, true(Ids == [door_1, fridge_1])) :- offered(openable, Ids).
test(sittable, true(Ids == [chair_1])) :- offered(sittable, Ids).
test(powered, true(Ids == [fridge_1])) :- offered(powered, Ids).
test(graspable, true(Ids == [cup_1])) :- offered(graspable, Ids).
test(movable, true(Ids == [basket_1, chair_1, cup_1, cup_2, gizmo_1])) :- offered(movable, Ids).
test(of_a_thing_that_was_never_measured_nobody_knows, all(T == [unknown])) :- affords(graspable, cup_2, T, _).
test(too_large_for_a_hand, all(T-V == [false-0.4])) :- affords(graspable, basket_1, T, [test(_, V, _, _, _)]).
test(what_a_strange_class_offers_nobody_knows, all(T == [unknown])) :- affords(sittable, gizmo_1, T, _).
test(a_known_class_without_is_without, all(T == [false])) :- affords(sittable, fridge_1, T, _).
test(an_operators_word_beats_the_class, [ all(T == [true]),
     setup(tell([attribute(gizmo_1, sittable, true)])), cleanup(tell([attribute(gizmo_1, sittable, maybe)])) ]) :-
    affords(sittable, gizmo_1, T, _).
test(rooms_and_robots_offer_nothing, true(Found == [])) :-
    findall(W-Id, ( member(Id, [room_1, agent_rob]), affords(W, Id, _, _) ), Found).
test(what_is_listed_is_what_is_tested, true(Odd == [])) :-
    findall(W-Id, ( affordance(W), affords(W, Id, true, _), \+ affords(W, Id, true, _) ), Odd).
test(every_class_named_is_a_class, true(Odd == [])) :-
    findall(C, ( ( affords_class(_, C) ; typical_weight(C, _, _) ), C \== book, \+ class(C), \+ part_kind(C, _) ), Odd).
test(weights_are_ranges, true(Odd == [])) :-
    findall(C, ( typical_weight(C, Least, Most), \+ ( 0 < Least, Least =< Most ) ), Odd).

test(carries_a_cup, all(T == [true])) :- can(can_carry, cup_1, T, _).
test(carries_no_fridge, all(T == [false])) :- can(can_carry, fridge_1, T, _).
test(a_chair_may_be_too_heavy, all(T == [unknown])) :- can(can_carry, chair_1, T, _).
test(a_strong_robot_carries_a_chair, [ all(T == [true]),
     setup(tell([attribute(agent_rob, payload_kg, 25.0)])), cleanup(tell([attribute(agent_rob, payload_kg, none)])) ]) :-
    can(can_carry, chair_1, T, _).
test(a_thing_that_was_weighed, [ all(T == [false]),
     setup(tell([attribute(cup_1, weight_kg, 7.5)])), cleanup(tell([attribute(cup_1, weight_kg, none)])) ]) :-
    can(can_carry, cup_1, T, _).
test(doors_that_the_robot_fits_through, all(D-T == [door_1-true, gap_1-unknown])) :- can(fits_through, D, T, _).
test(a_wide_robot_does_not, [ all(T == [false]),
     setup(tell([attribute(agent_rob, width_m, 0.9)])), cleanup(tell([attribute(agent_rob, width_m, 0.5)])) ]) :-
    can(fits_through, door_1, T, _).

:- end_tests(affordances).
