:- module(language,
          [ understand/2                % +Text, -Understood
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(solution_sequences)).
:- use_module(facts).
:- use_module(vocabulary).
:- use_module(names).
:- use_module(lexicon).
:- use_module(grammar).

/** <module> A little English: where things are, which are meant, and questions about them

    phrase(Kind, Relation, Names, Goal, Definite)

is what a phrase means: a goal in the vocabulary as text, the names of its
variables that are sought, and the(Name, Noun) for those that were called by
"the", of which there should be one. "the red cup on the table" means a thing; "near the
oven" means a place, given by a relation to a landmark, and the goal finds the
landmark; "how many cups are there" is a question.

    ?- understand("near the oven", U).
    U = phrase(place, near, ["Target"], "instance_of(Target, oven)", [the("Target", oven)]).

grammar.pl holds the sentences, lexicon.pl the words.
*/

%!  understand(+Text:string, -Understood) is det.
%
%   Understood is phrase(Kind, Relation, Names, Goal, Definite), or
%   problem(not_understood, Message, Hint) that says which word was not.

understand(Text, Understood) :-
    words(Text, Words),
    length(Words, Length),
    (   Words == []
    ->  Understood = problem(not_understood, "the phrase is empty", "say, for example, near the oven")
    ;   Length > 60
    ->  Understood = problem(not_understood, "the phrase has more than 60 words", "say it in fewer words")
    ;   call_with_inference_limit(meant(Words, Meant), 600_000, Result),
        Result \== inference_limit_exceeded
    ->  Understood = Meant
    ;   Understood = problem(not_understood, "the phrase has too many parts to be told apart", "say it in fewer words")
    ).

%   meant(+Words, -Understood): what phrases may mean grows fast with what they join, so this is called with a limit.
meant(Words, Understood) :-
    (   phrase(meaning(Kind, Relation, Sought, Goal), Words)
    ->  name_variables(Sought, Goal, Names, GoalText, Definite),
        Understood = phrase(Kind, Relation, Names, GoalText, Definite)
    ;   complaint(Words, Understood)
    ).

words(Text, Words) :-
    string_lower(Text, Lower),
    split_string(Lower, " \t\r\n,;!?", " \t\r\n.,;!?'\"`", Parts),
    exclude(==(""), Parts, Kept),
    foldl(word_atoms, Kept, Words, []).

word_atoms(Part, Words, Rest) :-
    contraction(Part, Full),
    !,
    append(Full, Rest, Words).
word_atoms(Part, [Word|Rest], Rest) :-
    split_string(Part, "-", "", Pieces),
    atomic_list_concat(Pieces, '_', Word).

contraction("what's", [what, is]).      contraction("where's", [where, is]).    contraction("who's", [who, is]).
contraction("isn't", [is, not]).        contraction("aren't", [are, not]).      contraction("there's", [there, is]).
contraction("doesn't", [does, not]).    contraction("don't", [do, not]).        contraction("can't", [cannot]).
contraction("i'm", [i, am]).            contraction("that's", [that, is]).

                /*******************************
                *           OUTPUT             *
                *******************************/

%   name_variables(+Sought, +Goal, -Names, -Text, -Definite): variables get names that say what they are.
name_variables(Sought, Goal0, Names, Text, Definite) :-
    strip(Goal0, visible, Goal1, The, []),
    flat(Goal1, Goal),
    foldl(name_sought, Sought, Names, [], _),
    foldl(name_definite, The, Names-[], _-Definite0),
    sort(Definite0, Definite),
    term_variables(Goal, Variables),
    foldl(name_variable, Variables, 1, _),
    with_output_to(string(Text),
                   write_term(Goal, [quoted(true), numbervars(true), spacing(next_argument)])).

name_sought(Sought, Name, Before, [Name|Before]) :-
    (   var(Sought)
    ->  Variable = Sought,
        ( memberchk("Target", Before) -> Name = "Target2" ; Name = "Target" )
    ;   Sought =.. [Kind, Variable],
        camel_case(Kind, Name)
    ),
    atom_string(Atom, Name),
    Variable = '$VAR'(Atom).

%   A thing called by "the" is named after its noun, unless it is sought.
name_definite('$the'(Variable, Noun), Names0-Definite, Names-[the(Name, Noun)|Definite]) :-
    (   var(Variable)
    ->  camel_case(Noun, Camel),
        free_name(Camel, Names0, 1, Name),
        atom_string(Atom, Name),
        Variable = '$VAR'(Atom),
        Names = [Name|Names0]
    ;   Variable = '$VAR'(Atom),
        atom_string(Atom, Name),
        Names = Names0
    ).

free_name(Camel, Taken, Index, Name) :-
    (   Index =:= 1
    ->  string_concat("The", Camel, Try)
    ;   format(string(Try), "The~w~d", [Camel, Index])
    ),
    (   memberchk(Try, Taken)
    ->  Next is Index+1,
        free_name(Camel, Taken, Next, Name)
    ;   Name = Try
    ).

camel_case(Noun, Camel) :-
    split_string(Noun, "_", "", Parts),
    maplist(capitalised, Parts, Capitals),
    atomic_list_concat(Capitals, Joined),
    atom_string(Joined, Camel).

capitalised(Part, Capital) :-
    sub_string(Part, 0, 1, _, First),
    !,
    string_upper(First, Upper),
    sub_string(Part, 1, _, 0, Rest),
    string_concat(Upper, Rest, Capital).
capitalised("", "").

name_variable('$VAR'(Name), Index, Next) :-
    atom_concat('_Other', Index, Name),
    Next is Index+1.

%   strip(+Goal, +Scope, -Stripped, -The, ?Rest): take out the marks of "the"; those in a hidden Scope are not told.
strip((A, '$the'(Thing, Noun)), Scope, Goal, The, Rest) :- !,
    ( Scope == visible, \+ node(Noun, _) -> The = ['$the'(Thing, Noun)|The1] ; The = The1 ),
    strip(A, Scope, Goal, The1, Rest).
strip((A, B), Scope, (GA, GB), The, Rest) :- !,
    strip(A, Scope, GA, The, The1),
    strip(B, Scope, GB, The1, Rest).
strip((A ; B), _, (GA ; GB), The, The) :- !,
    strip(A, hidden, GA, _, []),
    strip(B, hidden, GB, _, []).
strip(\+ A, _, \+ GA, The, The) :- !,
    strip(A, hidden, GA, _, []).
strip(forall(A, B), _, forall(GA, GB), The, The) :- !,
    strip(A, hidden, GA, _, []),
    strip(B, hidden, GB, _, []).
strip(aggregate_all(Spec, A, Result), _, aggregate_all(Spec, GA, Result), The, The) :- !,
    strip(A, hidden, GA, _, []).
strip(maximal(Value, A), Scope, maximal(Value, GA), The, Rest) :- !,
    strip(A, Scope, GA, The, Rest).
strip(minimal(Value, A), Scope, minimal(Value, GA), The, Rest) :- !,
    strip(A, Scope, GA, The, Rest).
strip(Goal, _, Goal, The, The).

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
    member(Word, Words),
    \+ part_of_noun(Words, Word),
    advice(Word, Message0, Hint0),
    !,
    format(string(Message), Message0, [Word]),
    Hint = Hint0.
complaint(Words, problem(not_understood, Message, Hint)) :-
    unknown_word(Words, Word),
    !,
    format(string(Message), "I do not know the word `~w`", [Word]),
    findall(Known, ( known_class(Known) ; node(Known, _) ; known_value(Known) ; word_in_use(Known) ), Names),
    most_alike(Word, Names, Nearest),
    did_you_mean(Nearest, Hint).
complaint(Words, problem(not_understood, Message, "say what is meant there: near the oven, on a table")) :-
    last(Words, Last),
    member(Missing, [[thing], [the, thing], [and, the, thing]]),
    append(Words, Missing, Whole),
    phrase(meaning(_, _, _, _), Whole),
    !,
    format(string(Message), "a thing is missing after `~w`", [Last]).
complaint(Words, problem(not_understood, Message, Hint)) :-
    understood_part(Words, Part, Rest),
    !,
    atomic_list_concat(Part, ' ', Spoken),
    next_words(Rest, Next),
    format(string(Message), "I understand `~w`, but not `~w` after it", [Spoken, Next]),
    Hint = "say, for example, the red cup on the table, or near the oven".
complaint(Words, problem(not_understood, Message, "say, for example, the red cup on the table, or near the oven")) :-
    Words = [First|_],
    last(Words, Last),
    format(string(Message), "I know the words from `~w` to `~w`, but not what they mean together", [First, Last]).

%   understood_part(+Words, -Part, -Rest): the longest beginning of Words that means something.
understood_part(Words, Part, Rest) :-
    findall(Length-R,
            ( limit(200, phrase(meaning(_, _, _, _), Words, R)), length(R, Length) ),
            Found),
    Found \== [],
    keysort(Found, [_-Rest|_]),
    append(Part, Rest, Words),
    Part \== [].

next_words(Rest, Next) :-
    (   Rest = [A, B, C|_]
    ->  atomic_list_concat([A, B, C], ' ', Next)
    ;   atomic_list_concat(Rest, ' ', Next)
    ).

%   advice(?Word, -Message, -Hint): words that people use and that say too little, or that belong elsewhere.
advice(Word, "`~w` does not say how much", "say the largest one, or larger than another, or taller than 1.2 m") :-
    memberchk(Word, [big, large, small, tiny, huge, little, tall, high, low, wide, narrow, heavy, light]).
advice(Word, "I cannot tell what `~w` stands for", "name the thing itself") :-
    memberchk(Word, [it, he, she, they, them, him, her, its, one, ones]).
advice(Word, "`~w` asks for a time, and phrases are about now",
       "ask when it was last seen, or ask a goal with a time") :-
    memberchk(Word, [was, were, will, yesterday, ago, before, after, did, had]).
advice(why, "`~w` is no question of its own", "ask the same without it, and for the explanation") :- !.
advice(Word, "I cannot tell what `~w` means of a thing", "say its colour, its class, or where it is") :-
    memberchk(Word, [nice, good, bad, clean, dirty, beautiful, ugly, old, new, favourite, favorite]).

%   unknown_word(+Words, -Word): the first that is no word of the grammar, no adjective and in no noun.
unknown_word(Words, Word) :-
    member(Word, Words),
    \+ word_in_use(Word),
    \+ phrase(adjective(_, _), [Word]),
    \+ part_of_noun(Words, Word),
    \+ atom_number(Word, _),
    !.

part_of_noun(Words, Word) :-
    append(_, Tail, Words),
    member(Length, [4, 3, 2, 1]),
    length(Noun, Length),
    append(Noun, _, Tail),
    memberchk(Word, Noun),
    phrase(noun(_, _, _, _), Noun),
    !.
