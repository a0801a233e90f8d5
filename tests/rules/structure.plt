:- use_module(library(plunit)).
:- use_module(library(lists)).
:- use_module(library(random)).
:- use_module('../../rules/structure').

/** <module> Claims about the constraint network of planes

A small room, with and without labels, and random scenes whose optimum is
found by generate and test.
*/

:- begin_tests(structure).

% A room of 4 m x 3 m x 2.5 m.
room([ plane(floor,   up,   0.0, 0.0, 4.0, 12.0, []),
       plane(ceiling, down, 2.5, 2.5, 4.0, 12.0, []),
       plane(south,   side, 0.0, 2.5, 4.0, 10.0, []),
       plane(north,   side, 0.0, 2.5, 4.0, 10.0, []),
       plane(west,    side, 0.0, 2.5, 3.0, 7.5,  []),
       plane(east,    side, 0.0, 2.5, 3.0, 7.5,  [])
     ]).

room_relations([ relation(parallel, floor, ceiling), relation(above, ceiling, floor),
                 relation(parallel, south, north),   relation(parallel, west, east),
                 relation(orthogonal, south, west),  relation(orthogonal, south, east),
                 relation(orthogonal, north, west),  relation(orthogonal, north, east),
                 relation(equalheight, south, west), relation(equalheight, south, east),
                 relation(equalheight, north, west), relation(equalheight, north, east)
               | Standing ]) :-
    findall(Relation,
            ( member(Wall, [south, north, west, east]), stands_in(Wall, Relation) ),
            Standing).

stands_in(Upright, relation(orthogonal, floor, Upright)).
stands_in(Upright, relation(above, Upright, floor)).
stands_in(Upright, relation(orthogonal, ceiling, Upright)).
stands_in(Upright, relation(above, ceiling, Upright)).

lies_in(Level, relation(parallel, floor, Level)).
lies_in(Level, relation(above, Level, floor)).
lies_in(Level, relation(above, ceiling, Level)).

furnished(Furniture, Own, Labels) :-
    room(Room),
    room_relations(Relations),
    append(Room, Furniture, Planes),
    findall(Relation,
            ( member(plane(Id, Facing, _, _, _, _, _), Furniture),
              (   Facing == side
              ->  stands_in(Id, Relation)
              ;   lies_in(Id, Relation)
              )
            ),
            Placed),
    append([Relations, Placed, Own], All),
    label_planes(Planes, All, Labels).

test(an_empty_room_has_no_clutter,
     Labels == [floor-floor, ceiling-ceiling, south-wall, north-wall, west-wall, east-wall]) :-
    furnished([], [], Labels).

test(no_planes_have_no_labels, Labels == []) :-
    label_planes([], [], Labels).

test(a_table_is_not_a_floor, Label == no_feature) :-
    furnished([plane((table), up, 0.74, 0.76, 1.6, 1.2, [])], [], Labels),
    memberchk((table)-Label, Labels).

test(many_tables_do_not_outvote_the_floor, Label-Floor == no_feature-floor) :-
    findall(plane(T, up, 0.75, 0.75, 1.5, 1.1, []), member(T, [t1, t2, t3, t4, t5, t6]), Tables),
    findall(relation(equalheight, A, B), ( member(A, [t1, t2]), member(B, [t3, t4, t5, t6]) ), Level),
    furnished(Tables, Level, Labels),
    memberchk(t3-Label, Labels),
    memberchk(floor-Floor, Labels).

test(a_shelf_board_seen_from_below_is_not_a_ceiling, Label == no_feature) :-
    furnished([plane(board, down, 1.2, 1.2, 1.0, 0.4, [])], [], Labels),
    memberchk(board-Label, Labels).

test(a_cupboard_front_is_not_a_wall, Label == no_feature) :-
    furnished([plane(front, side, 0.0, 2.1, 1.8, 3.8, [])], [relation(parallel, front, north)], Labels),
    memberchk(front-Label, Labels).

test(the_side_of_a_fridge_is_not_a_leaf, Label == no_feature) :-
    furnished([plane(side, side, 0.0, 1.8, 0.65, 1.2, [])], [relation(orthogonal, side, north)], Labels),
    memberchk(side-Label, Labels).

test(a_box_that_stands_askew_is_not_a_leaf, Front-Side == no_feature-no_feature) :-
    furnished([ plane(front, side, 0.0, 1.8, 0.65, 1.2, []), plane(side, side, 0.0, 1.8, 0.65, 1.2, []) ],
              [relation(orthogonal, front, side), relation(equalheight, front, side)], Labels),
    memberchk(front-Front, Labels),
    memberchk(side-Side, Labels).

test(a_leaf_ajar_is_a_door, Both == [door, door]) :-
    furnished([ plane(inner, side, 0.01, 2.0, 0.9, 1.8, []), plane(outer, side, 0.01, 2.0, 0.9, 1.8, []) ],
              [relation(parallel, inner, outer)], Labels),
    memberchk(inner-Inner, Labels),
    memberchk(outer-Outer, Labels),
    Both = [Inner, Outer].

test(a_leaf_is_as_wide_as_a_person_needs, all(Width-Label == [0.3-no_feature, 0.9-door, 1.6-no_feature])) :-
    member(Width, [0.3, 0.9, 1.6]),
    furnished([plane(leaf, side, 0.0, 2.0, Width, 1.8, [])], [], Labels),
    memberchk(leaf-Label, Labels).

test(stairs_are_several_steps_that_people_climb,
     all(Flight == [flight(12, 0.18, 0.01, 0.27, 0.9), flight(4, 0.15, 0.0, 0.3, 1.2)])) :-
    member(Flight, [ flight(12, 0.18, 0.01, 0.27, 0.9), flight(4, 0.15, 0.0, 0.3, 1.2),
                     flight(3, 0.18, 0.01, 0.27, 0.9), flight(6, 0.3, 0.01, 0.27, 0.9),
                     flight(6, 0.18, 0.08, 0.27, 0.9), flight(6, 0.18, 0.01, 0.1, 0.9),
                     flight(6, 0.18, 0.01, 0.27, 0.4) ]),
    stairs(Flight).

test(a_leaf_stands_on_a_floor_unless_it_was_seen_to_be_one,
     all(ZMin-Evidence-Label == [0.0-[]-door, 7.0-[]-no_feature, 7.0-[door-0.8]-door])) :-
    member(ZMin-Evidence, [0.0-[], 7.0-[], 7.0-[door-0.8]]),
    ZMax is ZMin+2.0,
    label_planes([ plane(floor, up, 0.0, 0.0, 4.0, 12.0, [floor-0.9]),
                   plane(leaf, side, ZMin, ZMax, 0.9, 0.9, Evidence) ],
                 [relation(orthogonal, floor, leaf), relation(above, leaf, floor)], Labels),
    memberchk(leaf-Label, Labels).

test(where_no_floor_was_seen_what_is_as_large_as_a_leaf_is_no_door, Label == wall) :-
    label_planes([plane(leaf, side, 0.0, 2.0, 0.9, 1.8, [])], [], [leaf-Label]).

test(a_leaf_at_right_angles_needs_to_be_seen_as_one, Plain-Seen == no_feature-door) :-
    furnished([plane(leaf, side, 0.0, 2.0, 0.9, 1.8, [])], [relation(orthogonal, leaf, north)], Labels),
    memberchk(leaf-Plain, Labels),
    furnished([plane(leaf, side, 0.0, 2.0, 0.9, 1.8, [door-0.8])], [relation(orthogonal, leaf, north)], Labels1),
    memberchk(leaf-Seen, Labels1).

test(the_half_seen_wall_is_a_wall_when_labelled_so, Plain-Seen == no_feature-wall) :-
    furnished([plane(part, side, 0.3, 1.2, 2.0, 1.6, [])], [], Labels),
    memberchk(part-Plain, Labels),
    furnished([plane(part, side, 0.3, 1.2, 2.0, 1.6, [wall-0.9])], [], Labels1),
    memberchk(part-Seen, Labels1).

test(what_is_labelled_furniture_is_no_feature, Label == no_feature) :-
    label_planes([plane(1, up, 0.7, 0.7, 1.5, 1.1, [(table)-0.7, cup-0.1])], [], [1-Label]).

test(without_labels_and_neighbours_a_level_plane_is_a_floor, Label == floor) :-
    label_planes([plane(1, up, 0.7, 0.7, 1.5, 1.1, [])], [], [1-Label]).

test(a_picture_says_nothing_about_the_wall_it_hangs_on, Label == wall) :-
    label_planes([plane(1, side, 0.0, 2.5, 3.0, 7.0, [picture-0.6, wall-0.3])], [], [1-Label]).

test(a_large_wall_stays_a_wall_behind_furniture, Label == wall) :-
    label_planes([plane(1, side, 0.0, 2.5, 4.0, 10.0, [sofa-0.6, wall-0.3])], [], [1-Label]).

test(floors_of_two_storeys_are_both_floors, Labels == [1-floor, 2-floor]) :-
    label_planes([plane(1, up, 0.0, 0.0, 4.0, 12.0, []), plane(2, up, 2.8, 2.8, 4.0, 12.0, [])],
                 [relation(parallel, 1, 2)], Labels).

test(oblique_planes_are_no_feature, Label == no_feature) :-
    label_planes([plane(1, oblique, 0.0, 1.0, 1.0, 1.0, [])], [], [1-Label]).

test(a_settled_plane_keeps_its_label_and_settles_others, Labels == [1-no_feature, 2-floor]) :-
    label_planes([plane(1, up, 0.7, 0.7, 1.5, 90.0, []), plane(2, up, 0.0, 0.0, 4.0, 1.0, given(floor))],
                 [relation(above, 1, 2)], Labels).

test(settled_planes_may_contradict_each_other, Labels == [1-floor, 2-floor]) :-
    label_planes([plane(1, up, 0.7, 0.7, 1.5, 1.1, given(floor)), plane(2, up, 0.0, 0.0, 4.0, 9.0, given(floor))],
                 [relation(above, 1, 2)], Labels).

test(under_is_above_the_other_way_round, LabelsA == LabelsB) :-
    room(Room),
    room_relations(Relations),
    findall(R, ( member(relation(N, A, B), Relations),
                 (   N == above
                 ->  R = relation(under, B, A)
                 ;   R = relation(N, A, B)
                 ) ), Turned),
    label_planes(Room, Relations, LabelsA),
    label_planes(Room, Turned, LabelsB).

test(the_cheapest_labelling_is_found, forall(between(1, 25, Seed))) :-
    random_scene(Seed, Planes, Relations),
    label_planes(Planes, Relations, Labels),
    labelling_cost(Planes, Relations, Labels, Cost),
    cheapest_by_generate_and_test(Planes, Relations, Least),
    Cost =< Least + 1.0e-9.

test(the_labelling_is_consistent, forall(between(101, 130, Seed))) :-
    random_scene(Seed, Planes, Relations),
    label_planes(Planes, Relations, Labels),
    labelling_cost(Planes, Relations, Labels, _).

test(a_hard_scene_is_labelled_within_the_bound, true(Used < 4*Bound)) :-
    tangle(120, Planes, Relations),
    search_bound(Bound),
    statistics(inferences, Before),
    label_planes(Planes, Relations, Labels),
    statistics(inferences, After),
    Used is After-Before,
    labelling_cost(Planes, Relations, Labels, _).

%   10 million inferences are about a second.

test(a_room_of_13_planes_takes_a_few_milliseconds, true(Used < 50 000)) :-
    clutter(7, 1, Furniture),
    inferences(furnished(Furniture, [], Labels), Used),
    length(Labels, 13).

test(forty_planes_take_a_tenth_of_a_second_at_most, true(Used < 1 000 000)) :-
    clutter(34, 2, Furniture),
    inferences(furnished(Furniture, [], Labels), Used),
    length(Labels, 40).

test(each_label_costs_something_and_no_feature_is_always_possible, all(Facing == [up, down, side, oblique])) :-
    member(Facing, [up, down, side, oblique]),
    Plane = plane(1, Facing, 0.0, 1.0, 1.0, 1.0, []),
    label_cost(Plane, no_feature, Cost),
    Cost > 0.0,
    forall(label_cost(Plane, _, C), C >= 0.0).

%   The reference: every assignment of possible labels, the consistent ones
%   weighed.

cheapest_by_generate_and_test(Planes, Relations, Least) :-
    findall(Cost, ( assignment(Planes, Labels), labelling_cost(Planes, Relations, Labels, Cost) ), Costs),
    min_list(Costs, Least).

assignment([], []).
assignment([Plane|Planes], [Id-Label|Labels]) :-
    arg(1, Plane, Id),
    label_cost(Plane, Label, _),
    assignment(Planes, Labels).

%   Scenes of up to 8 planes with relations drawn at random: harder to
%   satisfy than any that can be built.

random_scene(Seed, Planes, Relations) :-
    set_random(seed(Seed)),
    random_between(3, 8, N),
    findall(Plane, ( between(1, N, Id), random_plane(Id, Plane) ), Planes),
    findall(relation(Name, A, B),
            ( between(1, N, A),
              between(1, N, B),
              A < B,
              random(Chance),
              Chance < 0.6,
              random_member(Name, [parallel, orthogonal, equalheight, above, under])
            ),
            Relations).

random_plane(Id, plane(Id, Facing, ZMin, ZMax, Width, Area, Evidence)) :-
    random_member(Facing, [up, down, side, side, oblique]),
    random(0.0, 1.0, ZMin),
    random(0.5, 2.3, Rise),
    ZMax is ZMin+Rise,
    random(0.3, 2.0, Width),
    random(0.2, 8.0, Area),
    random_member(Evidence, [[], [], [wall-0.7, (table)-0.1], [(table)-0.8], [door-0.6], [floor-0.9], [ceiling-0.5, lamp-0.4]]).

%   N pieces of furniture of all kinds.

clutter(N, Seed, Furniture) :-
    set_random(seed(Seed)),
    findall(Plane, ( between(1, N, Id), random_furniture(Id, Plane) ), Furniture).

random_furniture(Id, plane(Id, Facing, ZMin, ZMax, Width, Area, [])) :-
    random_member(Facing, [up, up, side, side, side, down]),
    random(0.3, 1.9, Height),
    random(0.4, 1.8, Width),
    (   Facing == side
    ->  ZMin = 0.0,
        ZMax = Height,
        Area is Width*Height
    ;   ZMin = Height,
        ZMax = Height,
        Area is 0.6*Width
    ).

inferences(Goal, Used) :-
    statistics(inferences, Before),
    call(Goal),
    statistics(inferences, After),
    Used is After-Before.

%   N planes, each at odds with a third of the others.

tangle(N, Planes, Relations) :-
    set_random(seed(7)),
    findall(plane(Id, up, 0.0, 0.0, 1.0, Area, []), ( between(1, N, Id), random(1.0, 1.1, Area) ), Planes),
    findall(relation(above, A, B), ( between(1, N, A), between(1, N, B), A < B, random(C), C < 0.33 ), Relations).

:- end_tests(structure).
