:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(groups)).
:- use_module(rules(rooms)).
:- use_module(rules(properties)).
:- use_module(rules(ask)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

close_by(A, B, [measured(path_gap_upper, First, Second, 0.1), measured(path_gap_lower, First, Second, 0.1)]) :-
    msort([A, B], [First, Second]).

things(Facts) :-
    findall(Fact,
            ( member(Id-Class, [ plate_1-plate, fork_1-fork, knife_1-knife, fork_2-fork, table_1-dining_table,
                                 desk_1-desk, chair_1-office_chair, monitor_1-monitor ]),
              member(Fact, [node(Id, object), label(Id, Class)]) ),
            Things),
    close_by(plate_1, fork_1, Near1),
    close_by(plate_1, knife_1, Near2),
    close_by(desk_1, chair_1, Near3),
    append([ Things, Near1, Near2, Near3,
             [ measured(contact, plate_1, table_1, 1.0), measured(lowest_above, plate_1, table_1, 0.7),
               measured(contact, fork_1, table_1, 1.0), measured(lowest_above, fork_1, table_1, 0.7),
               measured(contact, knife_1, table_1, 1.0), measured(lowest_above, knife_1, table_1, 0.7),
               edge(on, monitor_1, desk_1, 1.0, 0.2, 1.0) ] ],
           Facts).

asked(Text, Truth, Rows) :-
    ask(Text, options(100, 2, 10 000 000, false, none), reply(Truth, _, Rows, _, none, _)).

:- begin_tests(groups, [setup(( things(Facts), with(Facts) ))]).

test(a_place_setting, all(P-F-K == [plate_1-fork_1-knife_1])) :- group(place_setting(P, F, K), true).
test(the_other_fork_is_of_none, all(T == [])) :- group(place_setting(_, fork_2, _), T).
test(a_workplace, all(D-S-M == [desk_1-chair_1-monitor_1])) :- group(workplace(D, S, M), true).
test(an_open_contact_leaves_it_open, [ all(T == [unknown]),
     setup(tell([measured(contact, knife_1, table_1, unknown)])),
       cleanup(tell([measured(contact, knife_1, table_1, 1.0)])) ]) :-
    group(place_setting(plate_1, fork_1, knife_1), T).
test(on_another_support_it_is_none, [ all(T == []),
     setup(tell([measured(contact, knife_1, table_1, 0.0), measured(contact, knife_1, desk_1, 1.0),
                   measured(lowest_above, knife_1, desk_1, 0.7)])),
       cleanup(tell([measured(contact, knife_1, table_1, 1.0), measured(contact, knife_1, desk_1, 0.0)])) ]) :-
    group(place_setting(plate_1, fork_1, knife_1), T).
test(asked, true(Truth-Rows == true-[[plate_1]])) :- asked("place_setting(X, fork, knife)", Truth, Rows).

test(of_what_was_never_seen_it_is_open, [ true(Truth == unknown),
     setup(tell([unobserved(world)])), cleanup(( things(Facts), with(Facts) )) ]) :-
    tell([label(knife_1, spoon)]),
    asked("place_setting(X, _, _)", Truth, _).

:- end_tests(groups).

:- begin_tests(properties, [setup(with([ node(t, object), label(t, table), size(t, 0.6, 1.2, 0.7),
                                         node(c, object), label(c, cup), attribute(c, colour, red), attribute(c, seen_color, grey),
                                         node(s, object), label(s, sofa), attribute(s, seen_color, blue),
                                         node(r, room), size(r, 4.0, 3.0, 2.5), attribute(r, area_m2, 10.5) ]))]).

test(dimensions, all(P-V =@= [height-0.7, width-1.2, depth-0.6, size-1.2])) :-
    member(P, [height, width, depth, size]),
    property(P, t, V).
test(volume, true(abs(V-0.504) < 1e-9)) :- property(volume, t, V).
test(a_rooms_area_is_that_of_its_footprint, all(A == [10.5])) :- property(area, r, A).
test(either_spelling, all(C == [red])) :- property(color, c, C).
test(what_was_seen_counts_where_nobody_told, true(Things == [s])) :- findall(T, property(color, T, blue), Things).
test(what_was_told_beats_what_was_seen, all(C-T == [red-c, blue-s])) :- property(color, T, C).
test(a_size_that_is_not_known_is_unknown, true(Truth == unknown)) :- asked("height(c, H), H > 0.2", Truth, _).
test(a_colour_that_is_not_known_is_unknown, true(Truth == unknown)) :- asked("color(t, green)", Truth, _).
test(a_colour_that_is_known_is_not_another, true(Truth == false)) :- asked("color(c, green)", Truth, _).

:- end_tests(properties).

sized(Facts) :-
    findall(Fact,
            ( member(Id-X-S, [a-0-1.0, b-1-2.0, c-5-3.0]),
              member(Fact, [node(Id, object), label(Id, box), size(Id, S, S, S), position(Id, X, 0, 0)]) ),
            Facts0),
    Facts = [node(o, object), label(o, oven), position(o, 0.9, 0, 0), seen(a, 0, 30), seen(b, 0, 20)|Facts0].

:- begin_tests(superlatives, [setup(( sized(Facts), with(Facts) ))]).

test(nearest, true(Rows == [[b]])) :- asked("nearest(X, box, oven)", true, Rows).
test(farthest, true(Rows == [[c]])) :- asked("farthest(X, box, o)", true, Rows).
test(largest, true(Rows == [[c]])) :- asked("largest(X, box)", true, Rows).
test(smallest, true(Rows == [[a]])) :- asked("smallest(X, box)", true, Rows).
test(latest, true(Rows == [[a]])) :- asked("latest(X, box)", true, Rows).
test(of_any_goal, true(Rows == [[1, b]])) :- asked("maximal(Y, (box(X), position(X, Y, _, _), Y < 3))", true, Rows).
test(two_that_are_equal_are_both, true(Rows == [[a], [b], [c]])) :-
    asked("minimal(_Y, (box(X), position(X, _, _Y, _)))", true, Rows).
test(of_none, true(Truth == false)) :- asked("maximal(Y, (box(X), position(X, Y, _, _), Y > 9))", Truth, _).
test(one_that_was_not_measured_may_be_larger, [ true(Truth == unknown),
     setup(tell([node(d, object), label(d, box)])), cleanup(tell([label(d, crate)])) ]) :-
    asked("maximal(V, (box(X), volume(X, V)))", Truth, _).
test(what_is_not_the_largest, true(Truth == false)) :- asked("largest(a, box)", Truth, _).
test(a_class_that_was_never_seen, [ true(Truth == unknown),
     setup(tell([unobserved(world)])), cleanup(( sized(Facts), with(Facts) )) ]) :-
    asked("nearest(X, toilet, oven)", Truth, _).

:- end_tests(superlatives).

:- begin_tests(excluded, [setup(with([ node(r, room), node(s, room), node(u, room), unobserved(u),
                                       node(oven_1, object), label(oven_1, oven),
                                       measured(footprint_share, oven_1, r, 1.0),
                                       node(sink_1, object), label(sink_1, washbasin),
                                       measured(footprint_share, sink_1, s, 1.0),
                                       node(stove_1, object), label(stove_1, stove),
                                       measured(footprint_share, stove_1, s, 1.0) ]))]).

test(without_a_sink_it_is_no_kitchen, all(T-R == [true-without([sink])])) :- excluded(r, kitchen, T, R).
test(with_all_it_may_be, all(T == [false])) :- excluded(s, kitchen, T, _).
test(what_was_not_seen_may_be_there, all(T == [unknown])) :- excluded(u, kitchen, T, _).
test(an_operators_word_excludes_the_others, [ all(T == [true]),
     setup(tell([attribute(s, type, laundry)])), cleanup(tell([attribute(s, type, kitchen)])) ]) :-
    excluded(s, kitchen, T, _).
test(every_needed_class_is_a_class, true(Odd == [])) :-
    findall(C, ( rooms:indispensable(_, Cs), member(C, Cs), \+ taxonomy:class(C) ), Odd).
test(no_type_speaks_of_a_room_that_it_excludes, true(Odd == [])) :-
    findall(T, ( rooms:indispensable(T, _), \+ type_of_room(T) ), Odd).

:- end_tests(excluded).

:- begin_tests(near_an_agent, [setup(with([ node(agent_rob, agent), position(agent_rob, 0, 0, 0), label(agent_rob, robot),
                                            node(r, room), node(q, room), edge(in, agent_rob, r, none, none, 1.0),
                                            node(c, object), label(c, cup), position(c, 0.4, 0, 0.8), size(c, 0.1, 0.1, 0.1),
                                            measured(footprint_share, c, r, 1.0),
                                            node(b, object), label(b, bowl), position(b, 0, 0.4, 0.8), size(b, 0.1, 0.1, 0.1),
                                            measured(footprint_share, b, q, 1.0),
                                            node(t, object), label(t, table), position(t, 2.5, 0, 0.4), size(t, 1, 1, 0.7),
                                            measured(footprint_share, t, r, 1.0) ]))]).

test(in_its_room, true(Truth-Rows == true-[[c]])) :- asked("near(X, agent_rob)", Truth, Rows).
test(the_other_way_round, true(Truth == true)) :- asked("near(agent_rob, cup)", Truth, _).
test(a_wall_may_be_between, true(Truth == unknown)) :- asked("near(bowl, agent_rob)", Truth, _).
test(too_far, true(Truth == false)) :- asked("near(table, agent_rob)", Truth, _).

:- end_tests(near_an_agent).
