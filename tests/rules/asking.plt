:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(vocabulary)).
:- use_module(rules(goals)).
:- use_module(rules(names)).
:- use_module(library(sandbox)).
:- use_module(rules(ask)).
:- use_module(library(plunit)).
:- use_module(library(lists)).
:- use_module(library(sandbox)).

asked(Text, Truth, Rows, Problem) :-
    ask(Text, options(100, 2, 1 000 000, false, none), reply(Truth, _, Rows, _, Problem, _)).

:- begin_tests(goals, [setup(with([ node(cup_1, object), label(cup_1, cup), node(t, object), label(t, table),
                                    measured(contact, cup_1, t, 1.0), measured(lowest_above, cup_1, t, 0.7) ]))]).

test(a_class_becomes_a_hidden_variable, true(Hidden-Visible == [T-table]-[X])) :-
    read_goal("on(X, table)", literal(on(X, T), Hidden, Visible), _, _).
test(an_id_is_itself, true(Goal == literal(on(cup_1, t), [], []))) :-
    read_goal("on(cup_1, t)", Goal, _, _).
test(each_occurrence_is_its_own, true(A \== B)) :-
    read_goal("on(cup, t), on(cup, t)", and(literal(on(A, t), _, _), literal(on(B, t), _, _)), _, _).
test(quantified_variables_are_not_answers, true(Names == ['X'])) :-
    read_goal("on(X, t), \\+ on(Y, X)", _, Bindings, _),
    findall(N, member(N=_, Bindings), Names).
test(underscored_variables_are_not_answers, true(Bindings == [])) :-
    read_goal("on(_X, _)", _, Bindings, _).
test(every_word_has_a_definition, true(Missing == [])) :-
    findall(Name/Arity,
            ( signature(Head, _), functor(Head, Name, Arity), functor(Any, Name, Arity),
              \+ predicate_property(vocabulary:Any, defined) ),
            Missing).
test(every_word_is_documented_once, true(Twice == [])) :-
    findall(N/A,
            ( signature(H, D), functor(H, N, A),
              ( \+ string(D) ; functor(G, N, A), findall(x, signature(G, _), [_,_|_]) ) ),
            Twice).
test(every_plain_builtin_is_safe, true(Unsafe == [])) :-
    findall(Goal,
            ( clause(goals:plain(Goal0), true), copy_term(Goal0, Goal),
              \+ catch(safe_goal(goals:Goal), _, fail) ),
            Unsafe).
test(nearest_first, true(Nearest == [oven])) :-
    most_alike(ovem, [oven, table, sofa], Nearest).
test(exchanged_letters, true(Nearest == [chair])) :-
    most_alike(chiar, [chair, table], Nearest).

:- end_tests(goals).

:- begin_tests(ask, [setup(with([ node(cup_1, object), label(cup_1, cup), node(t, object), label(t, table),
                                  measured(contact, cup_1, t, 1.0), measured(lowest_above, cup_1, t, 0.7) ]))]).

test(true, true(Truth-Rows == true-[[cup_1]])) :- asked("on(X, table)", Truth, Rows, none).
test(false, true(Truth-Rows == false-[])) :- asked("on(table, X)", Truth, Rows, none).
test(problem, true(Truth == unknown)) :- asked("on(X, tabel)", Truth, [], problem(unknown_name, _, _)).
test(inference_limit, true(Code == resource_limit)) :-
    ask("between(1, 100 000 000, X), X < 0", options(10, 10, 1000, false, none), Reply),
    Reply = reply(_, _, _, _, problem(Code, _, _), _).
test(trusted_calls_see_errors, true(Code == bad_argument)) :-
    call_trusted("X is foo+1", 10, 1, problem(Code, _, _)).

:- end_tests(ask).
