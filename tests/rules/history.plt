:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(history)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

/*  A cup stood on the table from 10 to 20 and stands on the shelf since 30, where it was on a tray from 30 to 40; the
    shelf came at 15, the tray was taken away at 50, now is 100. */

past([ parameter(now_ns, 100), parameter(history_since_ns, 10), told_past(on), told_past(all), past_relation(on),
       node(cup, object), node(table, object), node(shelf, object), seen(cup, 10, 90),
       lived(cup, object, vase, 10, 25), lived(cup, object, cup, 25, now),
       lived(table, object, table, 10, now), lived(shelf, object, shelf, 15, now), lived(tray, object, tray, 30, 50),
       sighted(tray, 30, 45),
       lasted(on, cup, table, 10, 20), lasted(on, cup, shelf, 30, now), lasted(on, tray, shelf, 30, 50),
       had(shelf, name, "Old shelf", 15, 40), had(shelf, state, clean, 15, 60), had(shelf, state, dusty, 60, now),
       event(vanished, tray, 50, none, none), event(relabelled, cup, 25, cup, vase),
       told(moment(breakfast, 12)) ]).

remembered :-
    past(Facts),
    with(Facts).

truth(Goal, Truth) :-
    (   call(history:Goal)
    ->  Truth = true
    ;   possibly_past(Goal)
    ->  Truth = unknown
    ;   Truth = false
    ).

:- begin_tests(moments, [setup(remembered), cleanup(forget_everything)]).

test(half_open, true(Truths == [false, true, true, false])) :-
    findall(T, ( member(At, [25, 10, 19, 20]), truth(holds(on(cup, table), At), T) ), Truths).
test(before_the_first_observation_nothing_is_known, true(Truths == [unknown, unknown])) :-
    findall(T, ( member(At, [0, 9]), truth(holds(on(cup, table), At), T) ), Truths).
test(of_a_thing_that_was_not_there_yet_nothing_is_known, true(Truth == unknown)) :-
    truth(holds(on(cup, shelf), 12), Truth).
test(nor_of_one_that_has_gone, true(Truth == unknown)) :-
    truth(holds(on(tray, shelf), 60), Truth).
test(now, all(X == [shelf])) :- holds(on(cup, X), now).
test(later_than_now_means_now, all(X == [shelf])) :- holds(on(cup, X), 1_000).
test(a_told_moment, all(X == [table])) :- holds(on(cup, X), breakfast).
test(some_time_ago, all(X == [table])) :- holds(on(cup, X), ago(8.5e-8)).
test(when_something_happened, all(X == [shelf])) :- holds(on(cup, X), vanished(tray)).
test(a_class_is_that_of_then, true(Truths == [true, false, true])) :-
    findall(T, ( member(Class-At, [vase-12, cup-12, cup-30]), truth(holds(on(any(Class), _), At), T) ), Truths).
test(a_label_of_then, all(Class == [vase])) :- holds(label(cup, Class), 12).
test(a_name_of_then, true(Truths == [true, false])) :-
    findall(T, ( member(At, [35, 45]), truth(holds(on(cup, any(old_shelf)), At), T) ), Truths).
test(an_attribute_of_then, all(Value == [clean])) :- holds(attribute(shelf, state, Value), 59).
test(a_life_goes_on_with_another_label, all(F-T == [10-now])) :- held(node(cup, object), F, T).
test(a_fact_must_be_named, throws(problem(unbound_variable, _, _))) :- holds(_, 12).
test(a_moment_must_be_known, throws(problem(unbound_variable, _, _))) :- holds(on(cup, table), _).
test(last_seen_of_what_has_gone, all(Thing-Ns == [cup-90, tray-45])) :- last_seen(Thing, Ns).

:- end_tests(moments).

:- begin_tests(events, [setup(remembered), cleanup(forget_everything)]).

test(changed_since, set(E == [vanished(tray), ended(on(tray, shelf))])) :- changed_since(40, E).
test(later_than_the_moment, all(E == [])) :- changed_since(50, E).
test(what_ended, all(X == [shelf])) :- changed_since(25, ended(on(tray, X))).
test(what_began, all(X == [cup, tray])) :- changed_since(25, began(on(X, shelf))).
test(relabelled, all(W-I == [vase-cup])) :- changed_since(start, relabelled(cup, W, I)).
test(what_is_forgotten_is_not_known, true(Truth == unknown)) :- truth(changed_since(5, moved(cup)), Truth).
test(what_is_remembered_is, true(Truth == false)) :- truth(changed_since(10, moved(cup)), Truth).

:- end_tests(events).

:- begin_tests(allen, [setup(remembered), cleanup(forget_everything)]).

between_ends(interval(A, B)) :- between(0, 4, A), between(1, 5, B), A < B.

relations(A, B, Relations) :-
    findall(R, allen(R, A, B), Relations).

converse(before, after).            converse(meets, met_by).
converse(overlaps, overlapped_by).  converse(starts, started_by).
converse(during, encloses).         converse(finishes, finished_by).
converse(equals, equals).

test(thirteen, true(Number == 13)) :- findall(R, allen_relation(R), Rs), length(Rs, Number).
test(exactly_one_holds, [forall(( between_ends(A), between_ends(B) )), true(Number == 1)]) :-
    relations(A, B, Relations),
    length(Relations, Number).
test(each_has_its_converse, [forall(( between_ends(A), between_ends(B) ))]) :-
    relations(A, B, [R]),
    relations(B, A, [C]),
    ( converse(R, C) -> true ; converse(C, R) ).
test(every_one_occurs, true(Number == 13)) :-
    findall(R, ( between_ends(A), between_ends(B), allen(R, A, B) ), Rs0),
    sort(Rs0, Rs),
    length(Rs, Number).
test(an_instant_is_an_interval, [forall(( member(M, [2, 3]), between_ends(B) )), true(Number == 1)]) :-
    relations(M, B, Relations),
    length(Relations, Number).
test(facts, all(R == [before])) :- allen(R, on(cup, table), on(cup, shelf)).
test(an_event_in_an_interval, [true, nondet]) :- during(vanished(tray), on(cup, shelf)).
test(an_open_end_is_later_than_now, all(R == [encloses])) :- allen(R, on(cup, shelf), interval(40, 90)).
test(two_open_ends_are_open, true(Truths == [unknown, unknown, unknown, false])) :-
    findall(T, ( member(R, [overlaps, encloses, finished_by, before]),
                 truth(allen(R, node(cup, object), on(cup, shelf)), T) ), Truths).
test(of_one_fact_they_are_equal, [true, nondet]) :- equals(on(cup, shelf), on(cup, shelf)).
test(sightings, all(R == [overlaps])) :- allen(R, seen(tray), interval(40, 50)).

:- end_tests(allen).
