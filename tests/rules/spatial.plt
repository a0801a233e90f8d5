:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(spatial)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

:- begin_tests(on, [setup(with([ node(cup, object), node(table, object), node(floor, structure),
                                 measured(lowest, cup, 0.75), measured(lowest, table, 0.0) ]))]).

test(a_fifth_of_the_footing_is_enough, true(Truth == true)) :-
    tell([measured(contact, cup, table, 0.2)]),
    judged(on, cup, table, Truth, _).
test(less_is_not, true(Truth == false)) :-
    tell([measured(contact, cup, table, 0.19)]),
    judged(on, cup, table, Truth, _).
test(an_unknown_contact_is_unknown, true(Truth == unknown)) :-
    tell([measured(contact, cup, table, unknown)]),
    judged(on, cup, table, Truth, _).
test(the_lower_one_is_never_on_the_higher, true(Truth == false)) :-
    tell([measured(contact, table, cup, 1.0)]),
    judged(on, table, cup, Truth, _).
test(everything_may_stand_on_structure, true(Truth == true)) :-
    tell([measured(contact, table, floor, 1.0), measured(lowest, floor, 0.01)]),
    judged(on, table, floor, Truth, _).
test(structure_stands_on_nothing, true(Truth == false)) :-
    tell([measured(contact, floor, table, 1.0)]),
    judged(on, floor, table, Truth, _).
test(equal_heights_are_decided_by_name, all(A-B == [plate-fork])) :-
    tell([ node(fork, object), node(plate, object), measured(lowest, fork, 0.7), measured(lowest, plate, 0.7),
           measured(contact, fork, plate, 0.9), measured(contact, plate, fork, 0.9) ]),
    judged(on, A, B, true, _),
    memberchk(A, [fork, plate]).
test(an_unknown_height_is_unknown, true(Truth == unknown)) :-
    tell([node(a, object), node(b, object), measured(contact, a, b, 0.9)]),
    judged(on, a, b, Truth, _).
test(boxes_give_the_height_when_nothing_else_does, true(Truth == true)) :-
    tell([ node(a, object), node(b, object), measured(contact, a, b, 0.9),
           position(a, 0, 0, 1.0), size(a, 0.1, 0.1, 0.2), position(b, 0, 0, 0.4), size(b, 1, 1, 0.8) ]),
    judged(on, a, b, Truth, _).
test(supports_is_the_inverse, all(A-B == [floor-table])) :-
    holds(supports, A, B),
    memberchk(A, [floor, table]), memberchk(B, [floor, table]).
test(a_stored_edge_holds_too, all(X == [shelf])) :-
    tell([edge(on, vase, shelf, 1, 0, 1)]),
    holds(on, vase, X).

:- end_tests(on).

:- begin_tests(in, [setup(with([ node(apple, object), node(bowl, object), node(table, object),
                                 node(room_1, room), node(room_2, room) ]))]).

test(both_shares_are_needed, all(Truth == [true])) :-
    tell([measured(footing_inside, apple, bowl, 0.8), measured(voxels_inside, apple, bowl, 0.3)]),
    judged(in, apple, bowl, Truth, _).
test(a_foot_outside_is_outside, all(Truth == [false])) :-
    tell([measured(footing_inside, apple, bowl, 0.7), measured(voxels_inside, apple, bowl, 0.9)]),
    judged(in, apple, bowl, Truth, _).
test(a_share_that_was_not_measured_is_unknown, all(Truth == [unknown])) :-
    tell([measured(footing_inside, apple, table, 0.9)]),
    judged(in, apple, table, Truth, _).
test(the_room_with_the_larger_share, true(Room == room_2)) :-
    tell([measured(footprint_share, table, room_1, 0.3), measured(footprint_share, table, room_2, 0.7)]),
    room_of(table, Room, _).
test(ties_go_by_name, true(Room == room_1)) :-
    tell([measured(footprint_share, table, room_1, 0.5), measured(footprint_share, table, room_2, 0.5)]),
    room_of(table, Room, _).
test(less_than_half_is_in_no_room, fail) :-
    tell([measured(footprint_share, table, room_1, 0.4), measured(footprint_share, table, room_2, 0.4)]),
    room_of(table, _, _).
test(what_straddles_goes_with_its_support, true(Rooms == [room_1])) :-
    tell([ measured(footprint_share, table, room_1, 0.6), measured(footprint_share, table, room_2, 0.4),
           measured(footprint_share, bowl, room_2, 0.7), measured(footprint_share, bowl, room_1, 0.3),
           measured(contact, bowl, table, 1.0), measured(lowest, bowl, 0.7), measured(lowest, table, 0.0) ]),
    findall(Room, holds(in, bowl, Room), Rooms).
test(what_is_clearly_in_a_room_stays_there, true(Rooms == [room_2])) :-
    tell([measured(footprint_share, bowl, room_2, 0.8), measured(footprint_share, bowl, room_1, 0.2)]),
    findall(Room, holds(in, bowl, Room), Rooms).
test(the_floor_is_no_support_in_this_sense, true(Rooms == [])) :-
    tell([ node(floor, structure), node(mat, object), measured(footprint_share, mat, room_1, 0.4),
           measured(contact, mat, floor, 1.0), measured(footprint_share, floor, room_2, 1.0) ]),
    findall(Room, holds(in, mat, Room), Rooms).
test(contents_of_a_room_include_what_stands_on_things_in_it, true(Sorted == [bowl, table])) :-
    tell([ measured(footprint_share, table, room_1, 1.0), measured(footprint_share, table, room_2, 0.0),
           measured(footprint_share, bowl, room_2, 0.5), measured(footprint_share, bowl, room_1, 0.5) ]),
    findall(A, holds(in, A, room_1), As),
    sort(As, Sorted).
test(all_pairs_are_found_unbound, true(Pairs == [bowl-room_1, (table)-room_1])) :-
    findall(A-R, ( holds(in, A, R), node(R, room), node(A, object) ), Pairs0),
    sort(Pairs0, Pairs).
test(an_unknown_share_is_unknown, true(Truth == unknown)) :-
    tell([node(rug, object), measured(footprint_share, rug, room_1, unknown)]),
    judged(in, rug, room_1, Truth, _).

:- end_tests(in).

:- begin_tests(above, [setup(with([ node(lamp, object), node(table, object), node(shelf, object),
                                    measured(footprint_overlap, lamp, table, 0.5),
                                    measured(rise, lamp, table, 0.6), measured(rise, table, lamp, -1.0) ]))]).

test(over_and_clear, all(A-B == [lamp-table])) :-
    judged(above, A, B, true, _).
test(under_is_the_inverse, all(B == [lamp])) :-
    holds(under, table, B).
test(not_through_a_ceiling, fail) :-
    tell([measured(structure_between, lamp, table, 1)]),
    holds(above, lamp, table).
test(unknown_when_it_is_not_known_what_is_between, true(Truth == unknown)) :-
    tell([measured(structure_between, lamp, table, unknown)]),
    once(judged(above, lamp, table, Truth, _)).
test(not_on_another_storey, fail) :-
    tell([measured(structure_between, lamp, table, 0), measured(same_storey, lamp, table, 0)]),
    holds(above, lamp, table).
test(not_when_it_rests_there, fail) :-
    tell([ measured(same_storey, lamp, table, 1), measured(contact, lamp, table, 0.4),
           measured(lowest, lamp, 1.0), measured(lowest, table, 0.0) ]),
    holds(above, lamp, table).
test(unknown_when_it_may_rest_there, true(Truth == unknown)) :-
    tell([measured(contact, lamp, table, unknown)]),
    once(judged(above, lamp, table, Truth, _)).
test(a_corner_reaching_over_is_not_above, fail) :-
    tell([measured(contact, lamp, table, 0.0), measured(footprint_overlap, lamp, table, 0.1)]),
    holds(above, lamp, table).

:- end_tests(above).

:- begin_tests(near, [setup(with([ node(a, object), node(b, object), measured(longer_side, a, 1.0),
                                   measured(longer_side, b, 0.6) ]))]).

test(half_the_sum_of_the_longer_sides, true(D =:= 0.8)) :- near_distance(a, b, D).
test(at_least_half_a_metre, true(D =:= 0.5)) :-
    tell([measured(longer_side, cup, 0.1), measured(longer_side, can, 0.1)]),
    near_distance(cup, can, D).
test(at_most_one_and_a_half, true(D =:= 1.5)) :-
    tell([measured(longer_side, bed, 2.2), measured(longer_side, sofa, 2.0)]),
    near_distance(bed, sofa, D).
test(the_box_serves_where_no_side_was_measured, true(D =:= 1.0)) :-
    tell([size(desk, 0.6, 1.2, 0.7), size(bin, 0.8, 0.2, 0.3)]),
    near_distance(desk, bin, D).
test(symmetric, true(( holds(near, a, b), holds(near, b, a) ))) :-
    tell([measured(path_gap_upper, a, b, 0.8), measured(path_gap_lower, a, b, 0.7)]).
test(found_from_either_side_and_unbound, true(L == [a-b, b-a])) :-
    findall(a-B, holds(near, a, B), L1),
    findall(b-A, holds(near, b, A), L2),
    append(L1, L2, L).
test(unknown_between_the_bounds, true(Truth == unknown)) :-
    tell([measured(path_gap_upper, a, b, 0.9), measured(path_gap_lower, a, b, 0.7)]),
    judged(near, b, a, Truth, _).
test(false_beyond_the_lower_bound, true(Truth == false)) :-
    tell([measured(path_gap_upper, a, b, 1.0e9), measured(path_gap_lower, a, b, 0.81)]),
    judged(near, a, b, Truth, _).
test(possible_but_not_certain, true(( possibly_holds(near, a, b), \+ holds(near, a, b) ))) :-
    tell([measured(path_gap_upper, a, b, unknown), measured(path_gap_lower, a, b, 0.1)]).

:- end_tests(near).

:- begin_tests(touching, [setup(with([measured(gap, a, b, 0.04)]))]).

test(one_voxel_is_added_to_the_margin, true(( holds(touching, b, a), Gap =:= 0.05 ))) :-
    tell([parameter(voxel_size_m, 0.02)]),
    contact_gap(Gap).
test(without_a_voxel_the_margin_alone, fail) :-
    with([measured(gap, a, b, 0.04)]),
    holds(touching, a, b).

:- end_tests(touching).

:- begin_tests(next_to, [setup(with([ node(cup, object), node(jar, object), node(table, object), node(shelf, object),
                                      measured(longer_side, cup, 0.1), measured(longer_side, jar, 0.1),
                                      measured(lowest, cup, 0.7), measured(lowest, jar, 0.7),
                                      measured(lowest, table, 0.0), measured(lowest, shelf, 0.0),
                                      measured(contact, cup, table, 1.0), measured(contact, jar, table, 1.0),
                                      measured(path_gap_upper, cup, jar, 0.2),
                                      measured(path_gap_lower, cup, jar, 0.2) ]))]).

test(near_on_one_support_with_nothing_between, true(holds(next_to, jar, cup))) :- once(holds(next_to, cup, jar)).
test(a_thing_between_parts_them, true(Truth == false)) :-
    tell([measured(things_between, cup, jar, 1)]),
    judged(next_to, jar, cup, Truth, _).
test(unknown_when_it_is_not_known_what_is_between, true(Truth == unknown)) :-
    tell([measured(things_between, cup, jar, unknown)]),
    judged(next_to, cup, jar, Truth, _).
test(another_support_parts_them, true(Truth == false)) :-
    tell([ measured(things_between, cup, jar, 0), measured(contact, jar, table, 0.0),
           measured(contact, jar, shelf, 1.0) ]),
    judged(next_to, cup, jar, Truth, _).
test(unknown_while_a_contact_is, true(Truth == unknown)) :-
    tell([measured(contact, jar, table, unknown)]),
    judged(next_to, cup, jar, Truth, _).
test(two_common_supports_are_one_answer, all(B == [jar])) :-
    tell([measured(contact, jar, table, 0.5), measured(contact, cup, shelf, 0.5), measured(contact, jar, shelf, 0.5)]),
    judged(next_to, cup, B, true, _).
test(two_pieces_of_one_floor_are_one_support, all(B == [jar])) :-
    tell([ node(f, structure), label(f, floor), position(f, 0, 0, 0.0), measured(contact, cup, f, 1.0),
           node(g, structure), label(g, floor), position(g, 3, 0, 0.05), measured(contact, jar, g, 1.0),
           measured(contact, cup, table, 0.0), measured(contact, jar, table, 0.0), measured(contact, cup, shelf, 0.0),
           measured(contact, jar, shelf, 0.0) ]),
    judged(next_to, cup, B, true, _).
test(two_floors_are_not, fail) :-
    tell([position(g, 3, 0, 2.7)]),
    holds(next_to, cup, jar).
test(not_near_not_next_to, fail) :-
    tell([measured(path_gap_upper, cup, jar, 0.6), measured(path_gap_lower, cup, jar, 0.6)]),
    holds(next_to, cup, jar).

:- end_tests(next_to).

:- begin_tests(attached_to, [setup(with([ node(picture, object), node(wall, structure), node(floor, structure),
                                          measured(side_contact, picture, wall, 0.9),
                                          measured(clear_below, picture, wall, 1.0) ]))]).

test(fixed_to_a_wall, all(W == [wall])) :- holds(attached_to, picture, W).
test(found_from_the_other_end, all(P == [picture])) :- holds(attached_to, P, wall).
test(a_corner_that_touches_is_not_fixed, fail) :-
    tell([measured(side_contact, picture, wall, 0.1)]),
    holds(attached_to, picture, wall).
test(what_stands_before_a_wall_is_not_fixed_to_it, true(Truth == false)) :-
    tell([measured(side_contact, picture, wall, 0.9), measured(contact, picture, floor, 1.0)]),
    judged(attached_to, picture, wall, Truth, _).
test(unknown_while_the_footing_is, true(Truth == unknown)) :-
    tell([measured(contact, picture, floor, unknown)]),
    judged(attached_to, picture, wall, Truth, _).
test(unknown_while_something_unseen_may_carry_it, true(Truths == [unknown, unknown, true])) :-
    tell([measured(contact, picture, floor, 0.0)]),
    findall(Truth,
            ( member(Clear, [unknown, 0.4, 0.5]),
              tell([measured(clear_below, picture, wall, Clear)]),
              judged(attached_to, picture, wall, Truth, _) ),
            Truths).
test(one_edge_one_way, true(Names == [attached_to(picture, wall)])) :-
    tell([measured(contact, picture, floor, 0.0)]),
    derived_edges_of([picture, wall], Edges),
    findall(Name, ( member(edge(R, A, B, _, _, _), Edges), Name =.. [R, A, B] ), Names).

:- end_tests(attached_to).

:- begin_tests(hanging_from, [setup(with([ node(lamp, object), node(ceiling, structure), node(table, object),
                                           measured(top_contact, lamp, ceiling, 1.0),
                                           measured(clear_below, lamp, ceiling, 1.0) ]))]).

test(from_the_ceiling, all(B == [ceiling])) :- holds(hanging_from, lamp, B).
test(a_pillar_that_stands_does_not_hang, fail) :-
    tell([measured(contact, lamp, table, 0.8)]),
    holds(hanging_from, lamp, ceiling).
test(unknown_tops_are_unknown, true(Truth == unknown)) :-
    tell([measured(contact, lamp, table, 0.0), measured(top_contact, lamp, ceiling, unknown)]),
    judged(hanging_from, lamp, ceiling, Truth, _).

:- end_tests(hanging_from).

:- begin_tests(part_of, [setup(with([ node(d, object), label(d, drawer), node(w, object), label(w, wardrobe),
                                      node(h, object), label(h, handle), node(t, object), label(t, table),
                                      measured(gap, d, w, 0.0), measured(gap, d, h, 0.0), measured(gap, h, t, 0.0) ]))]).

test(a_drawer_of_a_wardrobe_and_its_handle, set(A-B == [d-w, h-d])) :- judged(part_of, A, B, true, _).
test(from_either_side, true(As-Bs == [d]-[w])) :-
    findall(A, holds(part_of, A, w), As),
    findall(B, holds(part_of, d, B), Bs).
test(what_does_not_touch_is_no_part, fail) :-
    tell([measured(gap, d, w, 0.5)]),
    holds(part_of, d, w).
test(but_what_is_inside_is, all(A == [d])) :-
    tell([measured(footing_inside, d, w, 1.0), measured(voxels_inside, d, w, 1.0)]),
    holds(part_of, A, w).
test(unknown_gaps_are_unknown, true(Truth == unknown)) :-
    tell([measured(footing_inside, d, w, 0.0), measured(gap, d, w, unknown)]),
    once(judged(part_of, d, w, Truth, _)).

:- end_tests(part_of).

:- begin_tests(on_demand, [setup(with([ node(cup, object), node(rob, agent), node(door, structure), node(box, object),
                                        attribute(rob, width_m, 0.6) ]))]).

test(seen, true(Truth == true)) :-
    tell([measured(visible, cup, rob, 0.3), measured(possibly_visible, cup, rob, 0.5)]),
    judged(visible_from, cup, rob, Truth, _).
test(perhaps_seen_through_what_was_not_observed, true(Truth == unknown)) :-
    tell([measured(visible, cup, rob, 0.0)]),
    judged(visible_from, cup, rob, Truth, _).
test(hidden, true(Truth == false)) :-
    tell([measured(possibly_visible, cup, rob, 0.0)]),
    judged(visible_from, cup, rob, Truth, _).
test(reached, true(Truth == true)) :-
    tell([measured(way_upper, cup, rob, 3.0), measured(way_lower, cup, rob, 3.0)]),
    judged(reachable, cup, rob, Truth, _).
test(perhaps_reached_over_unseen_ground, true(Truth == unknown)) :-
    tell([measured(way_upper, cup, rob, 1.0e9)]),
    judged(reachable, cup, rob, Truth, _).
test(shut_in, true(Truth == false)) :-
    tell([measured(way_lower, cup, rob, 1.0e9)]),
    judged(reachable, cup, rob, Truth, _).
test(a_box_that_leaves_half_a_metre_blocks_a_robot_of_60_cm, all(A-D == [box-door])) :-
    tell([measured(clear_width, box, door, 0.5)]),
    judged(blocks, A, D, true, _).
test(a_narrower_robot_passes, fail) :-
    tell([attribute(rob, width_m, 0.4)]),
    holds(blocks, box, door).
test(none_of_them_is_stored, true(Edges == [])) :-
    derived_edges_of([cup, rob, box, door], Edges).

:- end_tests(on_demand).

:- begin_tests(edges, [setup(with([ node(cup, object), node(table, object), node(chair, object),
                                    measured(lowest, cup, 0.75), measured(lowest, table, 0.0),
                                    measured(contact, cup, table, 1.0), measured(footing_seen, cup, 1.0),
                                    measured(path_gap_upper, chair, table, 0.1),
                                    measured(path_gap_lower, chair, table, 0.1),
                                    measured(longer_side, table, 1.4), measured(longer_side, chair, 0.4) ]))]).

test(in_both_directions,
     true(Names == [near(chair, table), near(table, chair), on(cup, table), supports(table, cup)])) :-
    derived_edges_of([cup, table], Edges),
    findall(Name, ( member(edge(R, A, B, _, _, _), Edges), Name =.. [R, A, B] ), Names0),
    sort(Names0, Names).
test(the_same_as_one_by_one, true(Edges == All)) :-
    derived_edges_of([cup, table, chair], Edges),
    findall(edge(R, A, B, V, T, C), derived_edge(R, A, B, V, T, C), All0),
    sort(All0, All).
test(value_and_threshold_are_kept, true(V-T == 1.0-0.2)) :-
    derived_edge(supports, table, cup, V, T, _).
test(full_contact_is_sure, true(C =:= 1.0)) :-
    derived_edge(on, cup, table, _, _, C).
test(at_the_threshold_it_is_a_coin_toss, true(C =:= 0.5)) :-
    tell([measured(contact, cup, table, 0.2)]),
    derived_edge(on, cup, table, _, _, C).
test(a_footing_that_was_not_seen_is_less_sure, true(C =:= 0.75)) :-
    tell([measured(contact, cup, table, 1.0), measured(footing_seen, cup, 0.0)]),
    derived_edge(on, cup, table, _, _, C).
test(what_stands_on_a_thing_is_affected_by_it, true(Ids == [cup, table])) :-
    affected_by([table], Ids).
test(forgotten_things_have_no_edges, true(Edges == [])) :-
    setup_call_cleanup(open_string("forget(table).", S), update(S), close(S)),
    derived_edges_of([cup, table, chair], Edges).

:- end_tests(edges).

:- begin_tests(thresholds).

test(each_has_a_unit_and_a_reason, true(Bad == [])) :-
    findall(N, ( threshold(N, V, U, R), \+ ( number(V), memberchk(U, [metre, share]), string(R) ) ), Bad).
test(override_replaces, [true(Values == [0.3]), cleanup(override(contact_share(0.2)))]) :-
    override(contact_share(0.3)),
    findall(V, threshold(contact_share, V, _, _), Values).
test(an_unknown_threshold_is_refused, error(existence_error(threshold, nonsense))) :-
    override(nonsense(1)).
test(a_threshold_is_a_number, error(type_error(number, much))) :-
    override(contact_share(much)).
test(a_threshold_is_not_negative, error(_)) :-
    override(contact_share(-1)).

:- end_tests(thresholds).
