:- use_module(home).
:- use_module(rules(ask)).
:- use_module(rules(told_rules)).
:- use_module(rules(told_words)).
:- use_module(library(plunit)).

:- begin_tests(told_rules, [ setup(with([ node(cup_1, object), label(cup_1, cup), node(t, object), label(t, table),
                                          measured(contact, cup_1, t, 1.0), measured(lowest_above, cup_1, t, 0.7) ])),
                             cleanup(catch(unlearn(mine), _, true)) ]).

test(a_word_is_learned, true(Words == [word(laden(thing), "something stands on it")])) :-
    learn(mine, "signature(laden(thing), \"something stands on it\"). laden(X) :- on(_, X).", known, Words).
test(and_asked, true(Truth-Rows == true-[[t]])) :-
    ask("laden(X)", options(100, 2, 1 000 000, false, none), reply(Truth, _, Rows, _, none, _)).
test(its_clause_is_data, true(Goal = literal(on(_, X), [], _))) :-
    told_clause(laden(X), Goal, _).
test(what_is_refused_leaves_it, true(Code == forbidden)) :-
    catch(learn(mine, "signature(laden(thing), \"\"). laden(X) :- retract(X).", known, _), problem(Code, _, _), true),
    once(told_word(laden(_), _, "something stands on it", mine)).
test(no_program_has_it, fail) :-
    current_predicate(_:laden/1).
test(it_is_forgotten, fail) :-
    unlearn(mine),
    told_word(laden(_), _, _, _).
test(gone_names_are_for_what_was_accepted, throws(problem(unknown_name, _, _))) :-
    learn(mine, "signature(by(thing), \"\"). by(X) :- near(X, oven_7).", known, _).
test(names_may_be_gone_later, true(Words = [_])) :-
    learn(mine, "signature(by(thing), \"\"). by(X) :- near(X, oven_7).", any, Words).

:- end_tests(told_rules).
