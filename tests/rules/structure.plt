:- use_module(library(plunit)).
:- use_module(library(lists)).
:- use_module('../../rules/structure').

/** <module> Claims about the constraint network of planes

What labels cost and which go together; what the cheapest are is claimed in
tests/reasoning/test_labelling.py.
*/

:- begin_tests(structure).

scene([ plane(1, up, 0.0, 0.0, 4.0, 12.0, []), plane(2, up, 0.7, 0.7, 1.2, 0.9, []) ],
      [ relation(parallel, 2, 1), relation(above, 2, 1) ]).

test(a_table_top_over_a_floor_is_no_floor, true(abs(Cost-0.4525) < 1.0e-9)) :-
    scene(Planes, Relations),
    \+ labelling_cost(Planes, Relations, [1-floor, 2-floor], _),
    labelling_cost(Planes, Relations, [1-floor, 2-no_feature], Cost).

test(all_furniture_costs_more_than_one_piece, true(Dear > Cheap)) :-
    scene(Planes, Relations),
    labelling_cost(Planes, Relations, [1-floor, 2-no_feature], Cheap),
    labelling_cost(Planes, Relations, [1-no_feature, 2-no_feature], Dear).

test(no_feature_goes_with_everything_but_a_leaf_in_a_corner,
     all(Relation-Label == [parallel-wall, parallel-floor, parallel-ceiling, parallel-door, equalheight-wall,
                            equalheight-floor, equalheight-ceiling])) :-
    Plane = plane(1, side, 0.0, 2.0, 0.9, 1.8, []),
    member(Relation, [parallel, equalheight]),
    member(Label, [wall, floor, ceiling, door]),
    allowed(Relation, Plane, no_feature, Plane, Label).

test(the_network_holds_numbers_in_the_place_of_names, true(memberchk(shape(wall, [_, width >= Width, _]), Shapes))) :-
    wall_width(Width),
    network(network(_, _, Shapes, _, _, _, _, _, _, _, _)).

test(stairs_are_several_steps_that_people_climb,
     all(Flight == [flight(12, 0.18, 0.01, 0.27, 0.9), flight(4, 0.15, 0.0, 0.3, 1.2)])) :-
    member(Flight, [ flight(12, 0.18, 0.01, 0.27, 0.9), flight(4, 0.15, 0.0, 0.3, 1.2),
                     flight(3, 0.18, 0.01, 0.27, 0.9), flight(6, 0.3, 0.01, 0.27, 0.9),
                     flight(6, 0.18, 0.08, 0.27, 0.9), flight(6, 0.18, 0.01, 0.1, 0.9),
                     flight(6, 0.18, 0.01, 0.27, 0.4) ]),
    stairs(Flight).

test(each_label_costs_something_and_no_feature_is_always_possible, all(Facing == [up, down, side, oblique])) :-
    member(Facing, [up, down, side, oblique]),
    Plane = plane(1, Facing, 0.0, 1.0, 1.0, 1.0, []),
    label_cost(Plane, no_feature, Cost),
    Cost > 0.0,
    forall(label_cost(Plane, _, C), C >= 0.0).

:- end_tests(structure).
