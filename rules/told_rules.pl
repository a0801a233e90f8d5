:- module(told_rules,
          [ learn/4,                    % +Rules, +Text, +Names, -Words
            unlearn/1                   % +Rules
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(time)).
:- use_module(library(occurs)).
:- use_module(vocabulary).
:- use_module(goals).
:- use_module(readings).
:- use_module(told_words).

/** <module> Rules that are told while the world runs

New words, defined by those there are:

    signature(stacked(thing), "it stands on something that stands on another").
    stacked(X) :- on(X, Y), on(Y, _).

    signature(above_all(thing, thing), "over it, through any number of things").
    above_all(X, Y) :- on(X, Y).
    above_all(X, Y) :- on(X, Z), above_all(Z, Y).

They come over a network from nobody knows whom, so they are never loaded as a
program: a body is checked like a question, and may use nothing else; a new word
may not take the name of one that there is. Whoever asks a word pays for its
rules out of the limits of the question.
*/

most_clauses(200).
most_words(1_000).
seconds_to_check(2).

%!  learn(+Rules:atom, +Text:string, +Names, -Words:list) is det.
%
%   Take in the rules in Text under the name Rules, in the place of those that had
%   it. Words is a list of word(Signature, Documentation). Names is `known`, or
%   `any` for rules that were accepted before: a thing that they name may be gone;
%   before these are told again, one after the other, `signatures` takes in the
%   words of each, since rules may use the words of later ones.
%
%   @error problem(Code, Message, Hint); the rules are then those before.

learn(Rules, Text, Names, Words) :-
    read_all(Rules, Text, Clauses),
    partition(is_signature, Clauses, Signatures, Definitions),
    kept(Rules, OldWords, OldRules),
    catch(( in_time(define(Rules, Signatures, Definitions, Names)),
            still_defined(Rules, OldWords) ),
          Error,
          ( forget_own(Rules),
            maplist(assertz_in_words, OldWords),
            maplist(assertz_in_words, OldRules),
            throw(Error) )),
    findall(word(Signature, Documentation),
            ( told_word(Head, Kinds, Documentation, Rules),
              functor(Head, Word, _),
              Signature =.. [Word|Kinds] ),
            Words).

in_time(Goal) :-
    seconds_to_check(Seconds),
    catch(call_with_time_limit(Seconds, Goal), time_limit_exceeded,
          throw(problem(timeout, "the rules take too long to be checked", "tell fewer at a time"))).

kept(Rules, Words, Definitions) :-
    findall(word(H, K, D, Rules), told_words:word(H, K, D, Rules), Words),
    findall(stored_rule(H, Rules, C, P, G, N), told_words:stored_rule(H, Rules, C, P, G, N), Definitions).

assertz_in_words(Clause) :-
    assertz(told_words:Clause).

forget_own(Rules) :-
    retractall(told_words:word(_, _, _, Rules)),
    retractall(told_words:stored_rule(_, Rules, _, _, _, _)).

define(Rules, Signatures, _, signatures) :-
    !,
    maplist(declare(Rules), Signatures).
define(Rules, Signatures, Definitions, Names) :-
    forget_own(Rules),
    maplist(declare(Rules), Signatures),
    maplist(define_clause(Rules, Names), Definitions),
    forall(told_word(Head, _, _, Rules), defined(Rules, Head)).

%!  unlearn(+Rules:atom) is det.
%
%   @error problem(unknown_name, ...) without such rules, problem(rules_in_use,
%          ...) while others use a word of theirs

unlearn(Rules) :-
    kept(Rules, Words, _),
    (   Words == []
    ->  trouble(unknown_name, "there are no rules called ~w", [Rules])
    ;   true
    ),
    forall(member(word(Head, _, _, _), Words), not_needed(Rules, Head)),
    forget_own(Rules).

%   still_defined(+Rules, +OldWords): what others use is still a word.
still_defined(Rules, OldWords) :-
    forall(( member(word(Head, _, _, _), OldWords), \+ told_word(Head, _, _, Rules) ),
           not_needed(Rules, Head)).

not_needed(Rules, Head) :-
    (   told_words:stored_rule(_, Other, _, _, Goal, _),
        Other \== Rules,
        mentions(Goal, Head)
    ->  functor(Head, Name, Arity),
        trouble(rules_in_use, "~w/~d of the rules ~w is used by the rules ~w", [Name, Arity, Rules, Other])
    ;   true
    ).

mentions(Goal, Head) :-
    sub_term(Part, Goal),
    nonvar(Part),
    Part = told_words:Call,
    \+ Call \= Head,
    !.

                /*******************************
                *            READING           *
                *******************************/

%   read_all(+Rules, +Text, -Clauses): clause(Line, Term, Names) for each term of Text.
read_all(Rules, Text, Clauses) :-
    longest_goal(Longest),
    string_length(Text, Length),
    (   Length =< Longest
    ->  true
    ;   throw(problem(resource_limit, "the rules are longer than 20 000 characters", "tell them in parts"))
    ),
    setup_call_cleanup(open_string(Text, Stream),
                       read_clauses(Stream, Rules, 0, Clauses),
                       close(Stream)).

read_clauses(Stream, Rules, Before, Clauses) :-
    catch(read_term(Stream, Term, [ module(question), variable_names(Names), singletons(Lone), term_position(Position),
                                    syntax_errors(error), double_quotes(string), cycles(false) ]),
          Error,
          syntax_trouble(Rules, Error)),
    (   Term == end_of_file
    ->  Clauses = []
    ;   stream_position_data(line_count, Position, Line),
        most_clauses(Most),
        (   Before < Most
        ->  Now is Before+1
        ;   trouble(resource_limit, "the rules ~w are more than ~d clauses", [Rules, Most])
        ),
        (   Lone = [Name=_|_]
        ->  format(string(Message), "~w stands alone in its clause", [Name]),
            at_line(Rules, Line, problem(invalid_rules, Message, "write _ for a value that does not matter"))
        ;   true
        ),
        Clauses = [clause(Rules-Line, Term, Names)|More],
        read_clauses(Stream, Rules, Now, More)
    ).

syntax_trouble(Rules, error(syntax_error(What), Context)) :-
    !,
    ( Context = stream(_, Line, _, _) -> true ; Context = string(_, _) -> Line = 1 ; Line = 1 ),
    ( atom(What) -> atomic_list_concat(Words, '_', What), atomic_list_concat(Words, ' ', Said) ; Said = What ),
    trouble(syntax_error, "rules ~w, line ~d: ~w", [Rules, Line, Said]).
syntax_trouble(_, Error) :-
    throw(Error).

is_signature(clause(_, Term, _)) :-
    nonvar(Term),
    Term = signature(_, _).

                /*******************************
                *           CHECKING           *
                *******************************/

declare(Rules, clause(_-Line, signature(Signature, Documentation), _)) :-
    catch(declared(Rules, Signature, Documentation), problem(Code, Message, Hint),
          at_line(Rules, Line, problem(Code, Message, Hint))).

declared(Rules, Signature, Documentation) :-
    (   compound(Signature),
        Signature =.. [Word|Kinds],
        forall(member(Kind, Kinds), kind_of_argument(Kind))
    ->  true
    ;   trouble(invalid_rules, "~q is not a signature", [Signature],
                "name the kinds: thing, class, key, layer, value, number, text, any; as in signature(stacked(thing), \"…\")")
    ),
    ( string(Documentation) -> true ; trouble(invalid_rules, "~q: its second argument is no text", [Signature]) ),
    functor(Signature, Word, Arity),
    functor(Head, Word, Arity),
    new_word(Rules, Head),
    most_words(Most),
    aggregate_words(Count),
    ( Count < Most -> true ; trouble(resource_limit, "there are ~d words already", [Most]) ),
    assertz(told_words:word(Head, Kinds, Documentation, Rules)).

aggregate_words(Count) :-
    predicate_property(told_words:word(_, _, _, _), number_of_clauses(Count)),
    !.
aggregate_words(0).

kind_of_argument(Kind) :-
    memberchk(Kind, [thing, class, key, layer, measurement, value, number, text, any]).

new_word(Rules, Head) :-
    functor(Head, Word, Arity),
    (   told_word(Head, _, _, Other)
    ->  (   Other == Rules
        ->  trouble(invalid_rules, "~w/~d has two signatures", [Word, Arity])
        ;   trouble(forbidden, "~w/~d is a word of the rules ~w", [Word, Arity, Other])
        )
    ;   taken(Head)
    ->  trouble(forbidden, "~w/~d is a word already, and rules that are told may not change it", [Word, Arity],
                "give yours another name; thresholds are set in rule files that the server is started with")
    ;   \+ plain_name(Word)
    ->  trouble(forbidden, "~q is no name for a word: letters, digits and _ after a small letter", [Word])
    ;   true
    ).

plain_name(Word) :-
    atom_codes(Word, [First|Codes]),
    between(0'a, 0'z, First),
    forall(member(Code, Codes), ( between(0'a, 0'z, Code) ; between(0'0, 0'9, Code) ; Code == 0'_ )).

define_clause(Rules, Names, clause(_-Line, Term, Variables)) :-
    catch(defined_clause(Rules, Names, Term, Variables), problem(Code, Message, Hint),
          at_line(Rules, Line, problem(Code, Message, Hint))).

defined_clause(Rules, Names, Term, Variables) :-
    (   var(Term)
    ->  trouble(invalid_rules, "a variable is no rule", [])
    ;   ( Term = (:- _) ; Term = (?- _) )
    ->  trouble(forbidden, "rules that are told may not give orders to Prolog", [],
                "thresholds are set in rule files that the server is started with")
    ;   Term = (Head :- Body)
    ->  true
    ;   Term = (_ --> _)
    ->  trouble(forbidden, "rules that are told may not hold grammars", [])
    ;   Head = Term,
        Body = true
    ),
    ( callable(Head) -> true ; trouble(invalid_rules, "~q is no head of a rule", [Head]) ),
    functor(Head, Word, Arity),
    (   told_word(Head, _, _, Rules)
    ->  true
    ;   ( Head = _:_ ; taken(Head) )
    ->  trouble(forbidden, "~w/~d is not these rules' own to define", [Word, Arity],
                "give yours another name; thresholds are set in rule files that the server is started with")
    ;   trouble(invalid_rules, "~w/~d has no signature", [Word, Arity],
                "write, for example, signature(stacked(thing), \"it stands on something that stands on another\").")
    ),
    checked(Names, Body, Variables, Goal),
    readings(Goal, Certain, Possible),
    assertz(told_words:stored_rule(Head, Rules, Certain, Possible, Goal, Variables)).

checked(known, Body, Variables, Goal) :-
    checked_body(Body, Variables, Goal).
checked(any, Body, Variables, Goal) :-
    setup_call_cleanup(assertz(goals:any_name), checked_body(Body, Variables, Goal), retractall(goals:any_name)).

defined(Rules, Head) :-
    (   told_clause(Head, _, _)
    ->  true
    ;   functor(Head, Word, Arity),
        trouble(invalid_rules, "~w/~d of the rules ~w has a signature and no rule", [Word, Arity, Rules])
    ).

at_line(Rules, Line, problem(Code, Message0, Hint)) :-
    format(string(Message), "rules ~w, line ~d: ~w", [Rules, Line, Message0]),
    throw(problem(Code, Message, Hint)).

trouble(Code, Format, Arguments) :-
    trouble(Code, Format, Arguments, "").

trouble(Code, Format, Arguments, Hint) :-
    format(string(Message), Format, Arguments),
    throw(problem(Code, Message, Hint)).
