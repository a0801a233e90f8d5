:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(taxonomy)).
:- use_module(rules(states)).
:- use_module(rules(vocabulary)).
:- use_module(rules(plan_goals)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

:- begin_tests(states, [setup(with([ node(fridge_1, object), label(fridge_1, fridge),
                                     node(oven_1, object), label(oven_1, oven), attribute(oven_1, state, open),
                                     node(door_1, structure), label(door_1, door), attribute(door_1, open, false),
                                     node(box_1, object), label(box_1, cabinet), attribute(box_1, state, open),
                                     told(closed(box_1)), told(holding(agent_1, cup_1)) ]))]).

test(an_attribute_says_so, all(X == [oven_1])) :- open(X).
test(a_fact_outweighs_an_attribute, all(X == [box_1, door_1])) :- closed(X).
test(what_nobody_told_may_be, [nondet]) :- possible_state(open(fridge_1)).
test(what_was_told_may_not_be_otherwise, fail) :- possible_state(open(box_1)).
test(what_is_held, all(X == [cup_1])) :- holding(X).
test(a_fridge_is_shut_until_it_is_opened, [nondet]) :- offered_by(shut, fridge).
test(a_cup_is_poured_into, [nondet]) :- offered_by(vessel, cup).
test(a_shelf_is_not_shut, fail) :- offered_by(shut, shelf).
test(unheard_words_offer_nothing, fail) :- offered_by(_, flurb).
test(what_is_shut_is_openable, true(Odd == [])) :-
    findall(C, ( states:shut(C), \+ offered_by(openable, C) ), Odd).
test(classes_that_offer_are_classes, true(Odd == [])) :-
    findall(C, ( ( states:vessel(C) ; states:shut(C) ), \+ class(C) ), Odd).

:- end_tests(states).

:- begin_tests(plan_goals, [setup(with([ node(cup_1, object), label(cup_1, cup), node(mug_1, object), label(mug_1, mug),
                                         attribute(mug_1, color, red), node(table_1, object), label(table_1, table)
                                       ]))]).

test(classes_are_to_be_chosen,
     true(R == goal([wish(yes, on(v(0), v(1)))],
                    [domain(v(0), cup, [cup_1, mug_1]), domain(v(1), table, [table_1])], []))) :-
    plan_goal("on(cup, table)", R).
test(what_cannot_be_changed_says_what_is_meant, true(Rows == [[mug_1]])) :-
    plan_goal("on(X, table_1), attribute(X, color, red)", goal([wish(yes, on(V, table_1))], [], [context(_, [V], Rows)])).
test(all_is_written_out, true(W == [wish(yes, in(cup_1, table_1)), wish(yes, in(mug_1, table_1))])) :-
    plan_goal("forall(cup(X), in(X, table_1))", goal(W, _, _)).
test(what_shall_not_be, true(W == [wish(no, on(cup_1, table_1))])) :-
    plan_goal("\\+ on(cup_1, table_1)", goal(W, _, _)).
test(a_question_is_no_goal, true(Code == not_a_plan_goal)) :- plan_goal("cup(X)", problem(Code, _, _)).
test(alternatives_are_no_goal, true(Code == not_a_plan_goal)) :-
    plan_goal("on(cup_1, table_1) ; on(mug_1, table_1)", problem(Code, _, _)).
test(an_unknown_name, true(Code == unknown_name)) :- plan_goal("on(cup, tabel)", problem(Code, _, _)).

:- end_tests(plan_goals).
