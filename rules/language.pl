:- module(language,
          [ understand/2                % +Text, -Understood
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(facts).
:- use_module(taxonomy).
:- use_module(vocabulary).
:- use_module(names).

/** <module> A little English: where things are, and which are meant

    phrase(Kind, Relation, Names, Goal)

is what a phrase means: a goal in the vocabulary as text, and the names of its
variables that are sought. "the red cup on the table" means a thing; "near the
oven" means a place, given by a relation to a landmark, and the goal finds the
landmark.

    ?- understand("near the oven", U).
    U = phrase(place, near, ["Target"], "instance_of(Target,oven)").

The nouns are the classes, rooms, names and ids of the world at hand; the
adjectives are the values of its attributes.
*/

%!  understand(+Text:string, -Understood) is det.
%
%   Understood is phrase(Kind, Relation, Names, Goal), or problem(not_understood,
%   Message, Hint) that says which word was not.

understand(Text, Understood) :-
    words(Text, Words),
    (   Words == []
    ->  Understood = problem(not_understood, "the phrase is empty", "say, for example, near the oven")
    ;   phrase(meaning(Kind, Relation, Sought, Goal), Words)
    ->  name_variables(Sought, Goal, Names, GoalText),
        Understood = phrase(Kind, Relation, Names, GoalText)
    ;   complaint(Words, Understood)
    ).

words(Text, Words) :-
    string_lower(Text, Lower),
    split_string(Lower, " \t\r\n,;!?", " \t\r\n.,;!?'\"", Parts),
    exclude(==(""), Parts, Kept),
    maplist(word_atom, Kept, Words).

word_atom(Part, Word) :-
    split_string(Part, "-", "", Pieces),
    atomic_list_concat(Pieces, '_', Word).

                /*******************************
                *           GRAMMAR            *
                *******************************/

meaning(Kind, Relation, Sought, Goal) -->
    lead_in,
    sought(Kind, Relation, Sought, Goal).

sought(thing, none, [Thing], Goal) -->
    [what], ( [is] ; [are] ; [] ), !,
    attached(Thing, Goal).
sought(place, between, [A, B], (GoalA, GoalB)) -->
    [between], !,
    noun_phrase(A, GoalA),
    [and],
    noun_phrase(B, GoalB).
sought(place, Relation, [Landmark], Goal) -->
    preposition(Relation),
    noun_phrase(Landmark, Goal).
sought(thing, none, [Thing], Goal) -->
    noun_phrase(Thing, Goal).

lead_in --> [where, is], !.
lead_in --> [where, are], !.
lead_in --> [go, to], !.
lead_in --> [go], !.
lead_in --> [find], !.
lead_in --> [show, me], !.
lead_in --> [bring, me], !.
lead_in --> [].

noun_phrase(Thing, Goal) -->
    article,
    adjectives(Thing, Goal, Rest),
    noun(Thing, NounGoal),
    { Rest = Noun },
    modifiers(Thing, NounGoal, Noun).

article --> [Word], { article(Word) }, !.
article --> [].

article(the).   article(a).     article(an).    article(any).   article(some).
article(every). article(all).   article(my).    article(our).   article(this).
article(that).  article(these). article(those).

adjectives(Thing, (attribute(Thing, _, Value), Goal), Rest) -->
    [Value],
    { adjective(Value) },
    adjectives(Thing, Goal, Rest).
adjectives(_, Rest, Rest) --> [].

adjective(Value) :-
    attribute(_, _, Value), !.
adjective(Value) :-
    known_value(Value), !.

noun(Thing, NounGoal) -->
    { member(Length, [4, 3, 2, 1]), length(Words, Length) },
    Words,
    { atomic_list_concat(Words, '_', Joined),
      denotes(Joined, Thing, NounGoal)
    },
    !.

denotes(Word, Thing, object(Thing)) :-
    memberchk(Word, [thing, things, object, objects, something, anything, everything]),
    !.
denotes(Word, Thing, Thing = Word) :-
    node(Word, _),
    !.
denotes(Word, Thing, instance_of(Thing, Class)) :-
    singular(Word, Noun),
    noun_class(Noun, Class),
    !.

singular(Word, Word).
singular(Word, Noun) :-
    plural_ending(Ending, Singular),
    atom_concat(Stem, Ending, Word),
    atom_concat(Stem, Singular, Noun).

plural_ending(ies, y).
plural_ending(ves, f).
plural_ending(ves, fe).
plural_ending(es, '').
plural_ending(s, '').

%   A word for which another is in use here stands for the other.
noun_class(Noun, Noun) :-
    instance_of(_, Noun),
    !.
noun_class(Noun, Class) :-
    synonym(Noun, Class),
    instance_of(_, Class),
    !.
noun_class(Noun, Noun) :-
    known_class(Noun),
    !.
noun_class(Noun, Class) :-
    synonym(Noun, Class),
    known_class(Class).

synonym(A, B) :- same(A, B).
synonym(A, B) :- same(B, A).

same(television, tv).           same(telly, tv).                same(refrigerator, fridge).
same(couch, sofa).              same(settee, sofa).             same(trash_can, bin).
same(garbage_can, bin).         same(waste_basket, bin).        same(bookcase, bookshelf).
same(bookshelf, shelf).         same(bookcase, shelf).          same(stove, oven).
same(cooker, oven).             same(cupboard, cabinet).        same(washbasin, sink).
same(corridor, hallway).        same(hall, hallway).            same(lounge, living_room).
same(sitting_room, living_room).                                same(study, office).
same(tub, bathtub).             same(bath, bathtub).            same(screen, monitor).
same(carpet, rug).              same(robot, agent).             same(night_stand, nightstand).
same(bedside_table, nightstand).                                same(flower, plant).
same(painting, picture).        same(wc, toilet).

modifiers(Thing, Goal, (Goal, More)) -->
    which_is,
    attached(Thing, More).
modifiers(_, Goal, Goal) --> [].

which_is --> [that, is], !.
which_is --> [that, are], !.
which_is --> [which, is], !.
which_is --> [which, are], !.
which_is --> [].

attached(Thing, ((GoalA, GoalB), between(Thing, A, B))) -->
    [between], !,
    noun_phrase(A, GoalA),
    [and],
    noun_phrase(B, GoalB).
attached(Thing, (Goal, Literal)) -->
    preposition(Relation),
    noun_phrase(Other, Goal),
    { Literal =.. [Relation, Thing, Other] }.

preposition(in_front_of) --> [in, front, of].
preposition(left_of) --> ( [to, the, left, of] ; [on, the, left, of] ; [left, of] ).
preposition(right_of) --> ( [to, the, right, of] ; [on, the, right, of] ; [right, of] ).
preposition(next_to) --> ( [next, to] ; [beside] ).
preposition(on) --> ( [on, top, of] ; [on] ; [upon] ).
preposition(in) --> ( [inside, of] ; [inside] ; [in] ; [within] ; [into] ).
preposition(under) --> ( [under] ; [below] ; [beneath] ; [underneath] ).
preposition(above) --> ( [above] ; [over] ).
preposition(behind) --> [behind].
preposition(near) --> ( [near, to] ; [near] ; [close, to] ; [by] ; [at] ; [around] ).
preposition(touching) --> [touching].
preposition(attached_to) --> ( [attached, to] ; [fixed, to] ; [mounted, on] ).
preposition(hanging_from) --> ( [hanging, from] ; [hanging, off] ).
preposition(part_of) --> ( [part, of] ; [a, part, of] ).
preposition(visible_from) --> [visible, from].
preposition(blocks) --> [blocking].

                /*******************************
                *           OUTPUT             *
                *******************************/

name_variables(Sought, Goal0, Names, Text) :-
    flat(Goal0, Goal),
    (   Sought = [Target]
    ->  Target = '$VAR'('Target'),
        Names = ["Target"]
    ;   Sought = ['$VAR'('Target'), '$VAR'('Target2')],
        Names = ["Target", "Target2"]
    ),
    term_variables(Goal, Variables),
    foldl(name_variable, Variables, 1, _),
    with_output_to(string(Text),
                   write_term(Goal, [quoted(true), numbervars(true), spacing(next_argument)])).

name_variable('$VAR'(Name), Index, Next) :-
    atom_concat('_Other', Index, Name),
    Next is Index+1.

flat((A, B), Goal) :- !,
    flat(A, GA),
    flat(B, GB),
    joined(GA, GB, Goal).
flat(Goal, Goal).

joined((A, B), C, (A, D)) :- !,
    joined(B, C, D).
joined(A, B, (A, B)).

                /*******************************
                *          COMPLAINTS          *
                *******************************/

complaint(Words, problem(not_understood, Message, Hint)) :-
    unknown_word(Words, Word),
    !,
    format(string(Message), "I do not know the word `~w`", [Word]),
    findall(Known, ( known_class(Known) ; node(Known, _) ; known_value(Known) ), Names),
    most_alike(Word, Names, Nearest),
    did_you_mean(Nearest, Hint).
complaint(Words, problem(not_understood, Message, "say, for example, the red cup on the table, or near the oven")) :-
    last(Words, Last),
    format(string(Message), "I know the words but not what they mean together; they end with `~w`", [Last]).

unknown_word(Words, Word) :-
    append(_, Rest, Words),
    Rest = [Word|_],
    \+ function_word(Word),
    \+ adjective(Word),
    \+ part_of_noun(Words, Word),
    !.

part_of_noun(Words, Word) :-
    append(_, Tail, Words),
    member(Length, [4, 3, 2, 1]),
    length(Noun, Length),
    append(Noun, _, Tail),
    memberchk(Word, Noun),
    atomic_list_concat(Noun, '_', Joined),
    denotes(Joined, _, _),
    !.

function_word(Word) :- article(Word).
function_word(Word) :-
    memberchk(Word, [ where, is, are, go, to, find, show, bring, me, what, which, and, between, in, front, of, left,
                      right, next, beside, on, top, upon, inside, within, into, under, below, beneath, underneath,
                      above, over, behind, near, close, by, at, around, touching, attached, fixed,
                      mounted, hanging, from, off, part, visible, blocking ]).
