:- module(goals,
          [ read_goal/4,                % +Text, -Goal, -Bindings, -Names
            checked_body/3,             % +Body, +Names, -Goal
            taken/1,                    % +Head
            longest_goal/1,             % -Characters
            user_word/1,                % ?Head
            visible_variables/2         % +Goal, -Variables
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(solution_sequences)).
:- use_module(facts).
:- use_module(vocabulary).
:- use_module(history, [past_argument/3]).
:- use_module(names).
:- use_module(told_words).

/** <module> From the text of a question to a goal that may be run

read_goal/4 checks a question against the vocabulary and turns it into a tree:

  * literal(Call, Hidden, Visible): a word of the vocabulary; Hidden is a list of
    Variable-Class for the class names that stood in it
  * plain(Call): builtins without an effect (comparison, arithmetic, lists)
  * and/2, or/2, if/3, not/1, all/2, once/1, collect/3, sequence/2
  * extreme(How, Value, Template, Goal): the solutions of Goal with the most, or
    the least, Value

What is not in the vocabulary and not in the short lists below is refused before
anything runs. readings.pl makes callable goals of the tree.
*/

%!  longest_goal(-Characters) is det.

longest_goal(20_000).

%   any_name: while rules that were accepted before are told again, which may name what is gone.
:- dynamic any_name/0.

%   Questions are read without the operators that are declarations in Prolog and furniture in a home.
:- forall(member(Word, [table, dynamic, discontiguous, initialization, meta_predicate, module_transparent, multifile,
                        public, thread_local, thread_initialization, volatile, tnot]),
          ( op(0, fx, question:Word), op(0, fy, question:Word) )).

%!  read_goal(+Text:string, -Goal, -Bindings, -Names) is det.
%
%   Names is a list of Name=Variable for all variables, Bindings that for the
%   ones that an answer binds.
%
%   @error problem(Code, Message, Hint) and syntax errors

read_goal(Text, Goal, Bindings, All) :-
    string_length(Text, Length),
    longest_goal(Longest),
    (   Length =< Longest
    ->  true
    ;   throw(problem(resource_limit, "the goal is longer than 20 000 characters", ""))
    ),
    tidy(Text, Tidy),
    term_string(Term, Tidy, [ module(question), variable_names(All), syntax_errors(error),
                              double_quotes(string), cycles(false) ]),
    one_goal(Tidy),
    maplist(not_a_class, All),
    check(Term, Goal),
    free_variables(Goal, Free, []),
    include(free_and_named(Free), All, Bindings).

%!  checked_body(+Body, +Names, -Goal) is det.
%
%   Goal is the body of a rule, checked like a question; Names are its variables.
%
%   @error problem(Code, Message, Hint)

checked_body(Body, Names, Goal) :-
    maplist(not_a_class, Names),
    check(Body, Goal).

%!  taken(+Head) is semidet.
%
%   The name of Head means something already: as a word, in logic, as a class or in Prolog.

taken(Head) :-
    functor(Head, Name, Arity),
    (   signature(Other, _),
        functor(Other, Name, _)
    ;   user_word(Head)
    ;   plain(Head)
    ;   special(Name/Arity)
    ;   built_in(Name/Arity)
    ;   Arity =:= 1,
        known_class(Name)
    ),
    !.

%   built_in(+Indicator): Prolog has it; looked up so that nothing is loaded for the question.
built_in(Name/Arity) :-
    current_predicate(system:Name/Arity),
    !.

special(Special) :-
    memberchk(Special, [ not/1, forall/2, once/1, call/1, distinct/1, findall/3, aggregate_all/3, limit/2, order_by/2,
                         maximal/2, minimal/2, name/2, between/3, signature/2 ]).

%   one_goal(+Text): nothing follows the full stop of the goal, which reading would pass over in silence.
one_goal(Text) :-
    (   string_concat(Bare, ".", Text)
    ->  true
    ;   Bare = Text
    ),
    string_concat(Bare, "\n.", Whole),
    setup_call_cleanup(
        open_string(Whole, Stream),
        ( read_term(Stream, _, [module(question), double_quotes(string)]),
          catch(read_term(Stream, Rest, [module(question)]), _, Rest = more) ),
        close(Stream)),
    (   Rest == end_of_file
    ->  true
    ;   throw(problem(syntax_error, "the text goes on after the full stop of the goal", "ask one goal at a time"))
    ).

tidy(Text, Tidy) :-
    split_string(Text, "", " \t\r\n", [Trimmed]),
    (   string_concat("?-", Rest, Trimmed)
    ->  Tidy = Rest
    ;   Trimmed == ""
    ->  throw(problem(syntax_error, "the goal is empty", "ask, for example, near(X, oven)"))
    ;   Tidy = Trimmed
    ).

free_and_named(Free, Name=Variable) :-
    \+ sub_atom(Name, 0, 1, _, '_'),
    term_variables(Variable, Variables),
    member(One, Variables),
    among(Free, One),
    !.

%   free_variables(+Goal, -Variables, ?Rest): those that an answer binds, not those inside a negation or an aggregate.
free_variables(literal(_, _, Visible), Variables, Rest) :- !,
    append(Visible, Rest, Variables).
free_variables(plain(Call), Variables, Rest) :- !,
    term_variables(Call, Own),
    append(Own, Rest, Variables).
free_variables(not(_), Rest, Rest) :- !.
free_variables(all(_, _), Rest, Rest) :- !.
free_variables(collect(How, _, _), Variables, Rest) :- !,
    functor(How, _, Arity),
    arg(Arity, How, Result),
    term_variables(Result, Own),
    append(Own, Rest, Variables).
free_variables(sequence(_, Goal), Variables, Rest) :- !,
    free_variables(Goal, Variables, Rest).
free_variables(extreme(_, _, _, Goal), Variables, Rest) :- !,
    free_variables(Goal, Variables, Rest).
free_variables(Goal, Variables, Rest) :-
    Goal =.. [_|Parts],
    foldl(free_variables, Parts, Variables, Rest).

not_a_class(Name=_) :-
    atom_length(Name, Length),
    Length > 1,
    lower_snake(Name, Class),
    ( known_class(Class) ; Class \== Name, downcase_atom(Name, Class2), known_class(Class2), Class = Class2 ),
    !,
    format(string(Message), "~w is a variable, since it begins with a capital letter, and the name of a class", [Name]),
    format(string(Hint), "did you mean `~w`?", [Class]),
    throw(problem(unknown_name, Message, Hint)).
not_a_class(_).

lower_snake(Name, Class) :-
    atom_chars(Name, [First|Chars]),
    downcase_atom(First, Low),
    snake(Chars, Snaked),
    atomic_list_concat([Low|Snaked], Joined),
    ( known_class(Joined) -> Class = Joined ; downcase_atom(Name, Class) ).

snake([], []).
snake([Char|Chars], Snaked) :-
    (   char_type(Char, upper(Low))
    ->  Snaked = ['_', Low|Rest]
    ;   Snaked = [Char|Rest]
    ),
    snake(Chars, Rest).

                /*******************************
                *           CHECKING           *
                *******************************/

check(Term, _) :-
    var(Term),
    !,
    throw(problem(forbidden, "a variable cannot be asked", "")).
check((A, B), and(GA, GB)) :- !,
    check(A, GA),
    check(B, GB).
check((If -> Then ; Else), if(GIf, GThen, GElse)) :- !,
    check(If, GIf),
    check(Then, GThen),
    check(Else, GElse).
check((A ; B), or(GA, GB)) :- !,
    check(A, GA),
    check(B, GB).
check((If -> Then), if(GIf, GThen, plain(fail))) :- !,
    check(If, GIf),
    check(Then, GThen).
check(\+ A, not(G)) :- !,
    check(A, G).
check(not(A), not(G)) :- !,
    check(A, G).
check(forall(If, Then), all(GIf, GThen)) :- !,
    check(If, GIf),
    check(Then, GThen).
check(once(A), once(G)) :- !,
    check(A, G).
check(call(A), G) :- !,
    check(A, G).
check(distinct(A), G) :- !,
    check(A, G).
check(findall(Template, A, Bag), collect(findall(Template, Bag), Template, G)) :- !,
    check(A, G).
check(aggregate_all(Spec, A, Result), collect(aggregate_all(Spec, Result), Template, G)) :- !,
    spec_template(Spec, Template0),
    check(A, G),
    ( Template0 == all -> visible_variables(G, Template) ; Template = Template0 ).
check(limit(Count, A), sequence(limit(Count), G)) :- !,
    check(A, G).
check(order_by(Specs, A), sequence(order_by(Specs), G)) :- !,
    check(A, G).
check(maximal(Value, A), extreme(most, Value, Template, G)) :- !,
    check(A, G),
    visible_variables(G, Template).
check(minimal(Value, A), extreme(least, Value, Template, G)) :- !,
    check(A, G),
    visible_variables(G, Template).
check(_:_, _) :- !,
    throw(problem(forbidden, "a goal may not name a module", "")).
check(name(Id, Name), Goal) :- !,
    check(named(Id, Name), Goal).
check(between(Low, High, X), plain(between(Low, High, X))) :-   % whole numbers, not things
    ( number(Low) ; number(High) ; High == inf ),
    !.
check(Term, literal(Call, Hidden, Visible)) :-
    callable(Term),
    functor(Term, Name, Arity),
    askable(Name, Arity, Kinds, Module),
    !,
    Term =.. [_|Arguments],
    arguments(Arguments, Kinds, Name/Arity, 1, Called, Hidden),
    Call0 =.. [Name|Called],
    ( Module == vocabulary -> Call = Call0 ; Call = Module:Call0 ),
    pairs_keys(Hidden, HiddenVariables),
    term_variables(Called, Variables),
    exclude(among(HiddenVariables), Variables, Visible).
check(Term, Goal) :-                    % cup(X): a class is a word of its own
    compound(Term),
    compound_name_arguments(Term, Class, [Thing]),
    \+ plain(Term),
    known_class(Class),
    !,
    check(instance_of(Thing, Class), Goal).
check(Term, plain(Term)) :-
    callable(Term),
    plain(Term),
    !.
check(Term, _) :-
    callable(Term),
    !,
    refuse(Term).
check(Term, _) :-
    format(string(Message), "~q is not a goal", [Term]),
    throw(problem(syntax_error, Message, "ask, for example, near(X, oven)")).

among(List, Variable) :-
    member(Other, List),
    Other == Variable,
    !.

pairs_keys([], []).
pairs_keys([Key-_|Pairs], [Key|Keys]) :-
    pairs_keys(Pairs, Keys).

%   askable(+Name, +Arity, -Kinds, -Module): a word of the vocabulary, or of a user's rule file.
askable(Name, Arity, Kinds, vocabulary) :-
    functor(Head, Name, Arity),
    signature(Head, _),
    !,
    Head =.. [_|Kinds].
askable(Name, Arity, Kinds, user_rules) :-
    functor(Head, Name, Arity),
    user_word(Head),
    length(Kinds, Arity),
    maplist(=(any), Kinds).
askable(Name, Arity, Kinds, told_words) :-
    functor(Head, Name, Arity),
    told_word(Head, Kinds, _, _).

%!  user_word(+Head) is semidet.
%
%   Head is a predicate of a user's rule file.

user_word(Head) :-
    functor(Head, Name, Arity),
    current_predicate(user_rules:Name/Arity),
    \+ predicate_property(user_rules:Head, imported_from(_)).

arguments([], [], _, _, [], []).
arguments([Argument|Arguments], [Kind|Kinds], Word, Index, [Called|CalledMore], Hidden) :-
    argument(Kind, Argument, Word, Index, Called, Hidden, HiddenMore),
    Next is Index+1,
    arguments(Arguments, Kinds, Word, Next, CalledMore, HiddenMore).

argument(_, Argument, _, _, Argument, Hidden, Hidden) :-
    var(Argument),
    !.
argument(thing, Argument, _, _, Called, Hidden, HiddenMore) :-
    atom(Argument),
    !,
    thing(Argument, Called, Hidden, HiddenMore).
argument(any, Argument, _, _, Called, Hidden, HiddenMore) :-
    !,
    (   atom(Argument),
        \+ node(Argument, _),
        known_class(Argument)
    ->  Hidden = [Called-Argument|HiddenMore]
    ;   Called = Argument,
        Hidden = HiddenMore
    ).
argument(Kind, Argument, _, _, Called, Hidden, Hidden) :-
    memberchk(Kind, [state, occurrence, event, moment, once]),
    !,
    past_argument(Kind, Argument, Called).
argument(Kind, Argument, Word, Index, Argument, Hidden, Hidden) :-
    (   fits(Kind, Argument)
    ->  known(Kind, Argument)
    ;   Word = Name/Arity,
        format(string(Message), "~w/~d: argument ~d is ~q: expected a ~w", [Name, Arity, Index, Argument, Kind]),
        throw(problem(bad_argument, Message, ""))
    ).

thing(Atom, Atom, Hidden, Hidden) :-
    node(Atom, _),
    !.
thing(Atom, Called, [Called-Atom|Hidden], Hidden) :-
    (   known_class(Atom)
    ;   once(instance_of(_, Atom))
    ;   any_name
    ),
    !.
thing(Atom, _, _, _) :-
    findall(Known, ( known_class(Known) ; node_to_suggest(Known) ), Names),
    unknown_name(Atom, Names).

%   node_to_suggest(-Id): rooms and such, and things as long as they are few enough to be told apart by a slip.
node_to_suggest(Id) :-
    member(Layer, [building, storey, room, agent, structure, object]),
    limit(1000, node(Id, Layer)).

fits(number, Argument) :- number(Argument).
fits(text, Argument) :- ( string(Argument) ; atom(Argument) ).
fits(value, _).
fits(Kind, Argument) :-
    memberchk(Kind, [class, key, layer, measurement]),
    atom(Argument).

known(_, _) :-
    any_name,
    !.
known(class, Class) :- !,
    ( known_class(Class) -> true ; once(instance_of(_, Class)) -> true
    ; findall(C, known_class(C), Names), unknown_name(Class, Names) ).
known(key, Key) :- !,
    ( attribute(_, Key, _) -> true ; findall(K, known_key(K), Names), memberchk(Key, Names) -> true
    ; findall(K, known_key(K), Names), unknown_name(Key, Names) ).
known(layer, Layer) :- !,
    Layers = [building, storey, room, place, object, structure, agent],
    ( memberchk(Layer, Layers) -> true ; unknown_name(Layer, Layers) ).
known(measurement, Name) :- !,
    ( facts:store(Name, _, _) -> true ; findall(N, facts:store(N, _, _), Names), unknown_name(Name, Names) ).
known(value, Value) :-
    atom(Value),
    !,
    (   attribute(_, _, Value) -> true
    ;   findall(V, known_value(V), Names),
        ( memberchk(Value, Names) -> true ; unknown_name(Value, Names) )
    ).
known(_, _).

refuse(Term) :-
    functor(Term, Name, Arity),
    functor(Head, Name, Arity),
    (   (   built_in(Name/Arity)
        ;   predicate_property(user:Head, autoload(_))
        ;   memberchk(Name, [setof, bagof, assert])
        )
    ->  format(string(Message),
               "~w/~d may not be asked: questions use the vocabulary, logic, comparison and arithmetic",
               [Name, Arity]),
        throw(problem(forbidden, Message, ""))
    ;   findall(A, ( signature(Other, _), functor(Other, Name, A) ), [Right|_])
    ->  functor(Known, Name, Right),
        signature(Known, _),
        format(string(Message), "~w/~d is not known: ~w takes ~d arguments", [Name, Arity, Name, Right]),
        format(string(Hint), "~w", [Known]),
        throw(problem(unknown_predicate, Message, Hint))
    ;   known_class(Name)
    ->  format(string(Message), "~w is a class and takes one argument", [Name]),
        format(string(Hint), "did you mean ~w(X)?", [Name]),
        throw(problem(unknown_predicate, Message, Hint))
    ;   findall(Word, ( ( signature(Known, _) ; told_word(Known, _, _, _) ), functor(Known, Word, _) ), Words),
        most_alike(Name, Words, Nearest),
        format(string(Message), "~w/~d is not known", [Name, Arity]),
        did_you_mean(Nearest, Hint),
        throw(problem(unknown_predicate, Message, Hint))
    ).

%   plain(+Term): what may be called besides the vocabulary; nothing here changes anything or reaches outside.
plain(true).            plain(fail).            plain(false).           plain(repeat).
plain(_ = _).           plain(_ \= _).          plain(_ == _).          plain(_ \== _).
plain(_ @< _).          plain(_ @=< _).         plain(_ @> _).          plain(_ @>= _).
plain(_ is _).          plain(_ =:= _).         plain(_ =\= _).
plain(_ < _).           plain(_ =< _).          plain(_ > _).           plain(_ >= _).
plain(var(_)).          plain(nonvar(_)).       plain(ground(_)).
plain(atom(_)).         plain(number(_)).       plain(integer(_)).      plain(string(_)).
plain(between(_, _, _)).                        plain(succ(_, _)).      plain(plus(_, _, _)).
plain(length(_, _)).    plain(member(_, _)).    plain(memberchk(_, _)). plain(nth0(_, _, _)).
plain(nth1(_, _, _)).   plain(append(_, _, _)). plain(reverse(_, _)).   plain(last(_, _)).
plain(msort(_, _)).     plain(sort(_, _)).      plain(sort(_, _, _, _)).
plain(sum_list(_, _)).  plain(max_list(_, _)).  plain(min_list(_, _)).
plain(max_member(_, _)).                        plain(min_member(_, _)).
plain(select(_, _, _)). plain(subtract(_, _, _)).                       plain(intersection(_, _, _)).
plain(union(_, _, _)).  plain(list_to_set(_, _)).

%   spec_template(+Spec, -Template): what an aggregate collects; `all` for the variables of its goal.
spec_template(Spec, all) :-
    Spec == count,
    !.
spec_template(Spec, Spec) :-
    compound(Spec),
    functor(Spec, Kind, Arity),
    memberchk(Kind/Arity, [count/1, sum/1, max/1, min/1, bag/1, set/1, max/2, min/2]),
    !.
spec_template(Spec, _) :-
    format(string(Message), "aggregate_all: ~q is not count, count(X), sum(X), max(X), min(X), bag(X) or set(X)",
           [Spec]),
    throw(problem(bad_argument, Message, "")).

%!  visible_variables(+Goal, -Variables) is det.
%
%   The variables of a checked goal, without those that stand for a class name.

visible_variables(Goal, Variables) :-
    hidden_variables(Goal, Hidden, []),
    term_variables(Goal, All),
    exclude(among(Hidden), All, Variables).

hidden_variables(literal(_, Pairs, _), Hidden, Rest) :- !,
    pairs_keys(Pairs, Keys),
    append(Keys, Rest, Hidden).
hidden_variables(Goal, Hidden, Rest) :-
    compound(Goal),
    Goal \= plain(_),
    !,
    Goal =.. [_|Parts],
    foldl(hidden_variables, Parts, Hidden, Rest).
hidden_variables(_, Hidden, Hidden).
