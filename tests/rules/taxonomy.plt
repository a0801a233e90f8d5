:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(taxonomy)).
:- use_module(rules(rooms)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

:- begin_tests(taxonomy, [setup(with([ label(mug_1, mug), label(x_1, gizmo), label(x_2, espresso_cup),
                                       class_info(espresso_cup, thing, cup), class_info(gizmo, thing, none),
                                       told(subclass(pen_cup, cup)), told(subclass(pen_cup, toy)),
                                       label(x_3, pen_cup), class_info(loop_a, thing, loop_b), class_info(loop_b, thing, loop_a) ]))]).

test(a_class_is_below_itself, [nondet]) :- subclass(chair, chair).
test(the_way_up, true(Up == [armchair, seat, furniture, artefact])) :- findall(S, subclass(armchair, S), Up).
test(the_way_down_meets_the_way_up, true(Missing == [])) :-
    findall(C, ( subclass(C, furniture), \+ subclass(C, furniture) ), Missing).
test(the_way_down_finds_everything, true(Missing == [])) :-
    findall(C, ( class(C), subclass(C, furniture), \+ ( subclass(D, furniture), D == C ) ), Missing).
test(a_label_space_adds_parents, [nondet]) :- subclass(espresso_cup, tableware).
test(none_is_no_parent, true(Up == [gizmo])) :- findall(S, subclass(gizmo, S), Up).
test(a_circle_ends, true(Up == [loop_a, loop_b])) :- findall(S, subclass(loop_a, S), Up).
test(a_circle_ends_downwards, true(Down == [loop_a, loop_b])) :- findall(S, subclass(S, loop_a), Down).
test(every_class_has_at_most_one_kind_here, true(Twice == [])) :-
    findall(C, ( taxonomy:kind(C, A), taxonomy:kind(C, B), A @< B ), Twice).
test(nothing_is_below_itself_by_way_of_others, true(Circles == [])) :-
    findall(C, ( taxonomy:kind(C, _), subclass(C, S), S \== C, taxonomy:kind(S, C) ), Circles).
test(labels_count_upwards, true(Ids == [mug_1, x_2, x_3])) :-
    findall(Id, labelled(Id, tableware), Ids0), sort(Ids0, Ids).
test(labelled_with_an_id, all(C == [mug, cup, tableware, artefact])) :- labelled(mug_1, C).
test(an_unlisted_label_is_a_class) :- class(gizmo).
test(an_unheard_word_is_not, fail) :- class(flurb).
test(containers, true(Out == [])) :-
    findall(C, ( member(C, [basket, laundry_basket, cupboard, fridge, mug, bowl, bottle, sink, wardrobe, box, vase]),
                 \+ container_class(C) ), Out).
test(not_containers, true(In == [])) :-
    findall(C, ( member(C, [table, book, plate, sofa, wall, tv]), container_class(C) ), In).
test(all_containers_are_classes, true(Odd == [])) :-
    findall(C, ( container_class(C), \+ class(C) ), Odd).
test(speakers_are_classes, true(Odd == [])) :-
    findall(C, ( rooms:speaks_for(C, _, _), \+ class(C) ), Odd).

test(an_operator_adds_several_parents, true(Up == [artefact, cup, pen_cup, tableware, toy])) :-
    setof(S, subclass(pen_cup, S), Up).

:- end_tests(taxonomy).

room(Things) :-
    findall(Fact,
            ( nth1(I, Things, Class), atom_concat(thing_, I, Id),
              member(Fact, [node(Id, object), label(Id, Class), measured(footprint_share, Id, room_1, 1.0)]) ),
            Facts),
    with([node(room_1, room), node(room_2, room)|Facts]).

:- begin_tests(rooms).

test(kitchen, all(T == [kitchen])) :- room([oven, fridge, table, chair]), room_type(room_1, T).
test(kitchen_with_a_table_to_dine_at, all(T == [kitchen])) :-
    room([oven, sink, dining_table, dining_chair]), room_type(room_1, T).
test(living_room, all(T == [living_room])) :- room([sofa, tv, rug, book]), room_type(room_1, T).
test(bedroom, all(T == [bedroom])) :- room([bed, wardrobe, lamp, desk]), room_type(room_1, T).
test(child_room, all(T == [child_room])) :- room([bed, desk, teddy_bear, ball]), room_type(room_1, T).
test(toys_in_a_hallway, all(T == [])) :- room([ball, toy_block, shoe]), room_type(room_1, T).
test(bathroom, all(T == [bathroom])) :- room([toilet, sink, mirror, washing_machine]), room_type(room_1, T).
test(office, all(T == [office])) :- room([desk, chair, monitor, shelf]), room_type(room_1, T).
test(dining_room, all(T == [dining_room])) :- room([dining_table, chair]), room_type(room_1, T).
test(laundry, all(T == [laundry])) :- room([washing_machine, dryer]), room_type(room_1, T).
test(chairs_tell_nothing, fail) :- room([chair, chair, lamp]), room_type(room_1, _).
test(many_of_one_class_speak_once, fail) :- room([cup, plate, bowl, cup, mug, glass]), room_type(room_1, _).
test(two_kinds_of_one_speaker_count_once, true(Sum =:= 1.7)) :-
    room([oven, mug, glass]), room_type(room_1, kitchen, evidence(Sum, _)).
test(the_reason_comes_weightiest_first,
     true(Because == [speaks(oven, 1.5), speaks(sink, 0.4), speaks(tableware, 0.2)])) :-
    room([cup, sink, oven]), room_type(room_1, _, evidence(_, Because)).
test(an_operators_word_beats_the_evidence, all(T == [pantry])) :-
    room([oven]), tell([attribute(room_1, type, pantry)]), room_type(room_1, T).
test(three_doors_make_a_hallway, all(T-R == [hallway-doors(3)])) :-
    room([lamp]),
    findall(edge(connects, Door, room_1, 1, 0, 1), member(Door, [d1, d2, d3]), Edges),
    tell(Edges),
    room_type(room_1, T, R).
test(the_type_follows_the_facts, true(T1-T2 == kitchen-bathroom)) :-
    room([oven]), room_type(room_1, T1),
    tell([label(thing_1, toilet)]), room_type(room_1, T2).
test(found_by_type, all(R == [room_1])) :- room([oven]), room_type(R, kitchen).
test(told_types_can_be_asked_for, [nondet]) :-
    room([oven]), tell([attribute(room_2, type, winter_garden)]), type_of_room(winter_garden).

:- end_tests(rooms).
