:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(language)).
:- use_module(library(plunit)).
:- use_module(library(occurs)).

means(Text, Kind, Relation, Goal) :-
    understand(Text, phrase(Kind, Relation, _, String)),
    term_string(Goal, String).

:- begin_tests(language, [setup(with([ node(cup_1, object), label(cup_1, cup), attribute(cup_1, color, red),
                                       node(room_1, room), name(room_1, "Guest room"),
                                       label(t, table), node(t, object), label(s, shelf), label(tv_1, tv) ]))]).

test(near_a_landmark, true(Goal = instance_of(_, oven))) :-
    means("near the oven", place, near, Goal).
test(in_a_room_type, true(Goal = instance_of(_, kitchen))) :-
    means("in the kitchen", place, in, Goal).
test(prepositions, true(Bad == [])) :-
    findall(Text-Relation,
            ( member(Text-Relation,
                     [ "on the table"-on, "on top of the table"-on, "under the table"-under, "below the table"-under,
                       "above the table"-above, "behind the tv"-behind, "in front of the tv"-in_front_of,
                       "left of the tv"-left_of, "to the right of the tv"-right_of, "next to the tv"-next_to,
                       "beside the tv"-next_to, "inside the fridge"-in, "by the oven"-near, "close to the oven"-near ]),
              \+ means(Text, place, Relation, _) ),
            Bad).
test(a_thing, true(Goal = (attribute(X, _, red), instance_of(X, cup), instance_of(Y, table), on(X, Y)))) :-
    means("the red cup on the table", thing, none, Goal).
test(the_nearest_noun_is_modified,
     true(Goal = (instance_of(X, cup), instance_of(Y, table), instance_of(Z, kitchen), in(Y, Z), on(X, Y)))) :-
    means("the cup on the table in the kitchen", thing, none, Goal).
test(a_landmark_may_be_described, true(Goal = (instance_of(X, table), instance_of(Y, kitchen), in(X, Y)))) :-
    means("under the table in the kitchen", place, under, Goal).
test(plurals, true(Goal = instance_of(_, cup))) :- means("the cups", thing, none, Goal).
test(irregular_plurals, true(Goal = instance_of(_, shelf))) :- means("shelves", thing, none, Goal).
test(two_words, true(Goal = instance_of(_, coffee_table))) :- means("the coffee table", thing, none, Goal).
test(hyphens, true(Goal = instance_of(_, coffee_table))) :- means("the coffee-table", thing, none, Goal).
test(names, true(Goal = instance_of(_, guest_room))) :- means("in the guest room", place, in, Goal).
test(ids, true(Goal = (_ = cup_1))) :- means("cup_1", thing, none, Goal).
test(synonyms, true(Goal = instance_of(_, tv))) :- means("the television", thing, none, Goal).
test(questions, true(Goal = instance_of(_, cup))) :- means("Where is the cup?", thing, none, Goal).
test(what_is_there, true(Goal = (instance_of(Y, table), on(_, Y)))) :-
    means("What is on the table?", thing, none, Goal).
test(anything, true(Goal = (object(X), instance_of(Y, table), on(X, Y)))) :-
    means("everything on the table", thing, none, Goal).
test(relative_clause, true(Goal = (instance_of(X, cup), instance_of(Y, oven), near(X, Y)))) :-
    means("the cup that is near the oven", thing, none, Goal).
test(between_two, true(Names-Goal == ["Target", "Target2"]-"instance_of(Target, cup), instance_of(Target2, oven)")) :-
    understand("between the cup and the oven", phrase(place, between, Names, Goal)).
test(what_is_between_two,
     true(Goal = (instance_of(Y, cup), instance_of(Z, oven), between(_, Y, Z)))) :-
    means("what is between the cup and the oven", thing, none, Goal).
test(what_hangs_and_what_is_fixed, true(Bad == [])) :-
    findall(Text, ( member(Text-Relation, [ "what is hanging from the shelf"-hanging_from,
                                            "what is mounted on the shelf"-attached_to,
                                            "everything attached to the shelf"-attached_to,
                                            "what is blocking the door"-blocks ]),
                    \+ ( means(Text, thing, none, Goal), sub_term(Literal, Goal), functor(Literal, Relation, 2) ) ),
            Bad).
test(the_unknown_word_is_named, true(Code-Message == not_understood-"I do not know the word `tabel`")) :-
    understand("on the tabel", problem(Code, Message, _)).
test(the_hint_is_near, true(sub_string(Hint, _, _, _, "`table`"))) :-
    understand("on the tabel", problem(_, _, Hint)).
test(known_words_without_sense, true(Code == not_understood)) :-
    understand("the near table on", problem(Code, _, _)).
test(nothing, true(Code == not_understood)) :-
    understand("  ?! ", problem(Code, _, _)).
test(quotes_do_no_harm, true(Code == not_understood)) :-
    understand("'); halt. --", problem(Code, _, _)).

:- end_tests(language).
