:- use_module(home).
:- use_module(rules(goals)).
:- use_module(rules(ordering)).
:- use_module(library(plunit)).

words(literal(Call, Hidden, _), Call-Classes) :- findall(C, member(_-C, Hidden), Classes).
words(plain(Call), Call).
words(not(_), not).
words(and(A, B), (WA, WB)) :- words(A, WA), words(B, WB).

ordered(Text, Words) :-
    read_goal(Text, Goal, _, _),
    well_ordered(Goal, Ordered),
    words(Ordered, Words).

:- begin_tests(ordering, [setup(with([ node(oven_1, object), label(oven_1, oven), node(room_1, room),
                                       node(cup_1, object), label(cup_1, cup), node(cup_2, object), label(cup_2, cup),
                                       node(cup_3, object), label(cup_3, cup), node(table_1, object),
                                       label(table_1, table) ]))]).

test(the_rare_class_comes_first, true) :-
    ordered("cup(X), near(X, oven)", (near(_, _)-[oven], instance_of(_, cup)-[])).
test(an_id_comes_first, true) :-
    ordered("cup(X), on(X, Y), in(X, room_1)", (in(_, room_1)-[], instance_of(_, cup)-[], on(_, _)-[])).
test(a_join_follows_what_is_bound, true) :-
    ordered("table(Y), cup(X), on(X, Y)", (instance_of(_, table)-[], on(_, _)-[], instance_of(_, cup)-[])).
test(places_are_not_hidden_from_what_lists_them, true) :-
    ordered("instance_of(X, place), in(X, room_1)", (instance_of(_, place)-[], in(_, room_1)-[])).
test(what_compares_stays_behind_what_it_compares, true) :-
    ordered("cup(X), size(X, S), S > 1, near(X, oven)",
            (instance_of(_, cup)-[], size(_, _)-[], _ > 1, near(_, _)-[oven])).
test(a_negation_stays_where_it_is, true) :-
    ordered("cup(X), \\+ near(X, oven), in(X, room_1)", (instance_of(_, cup)-[], not, in(_, room_1)-[])).

:- end_tests(ordering).
