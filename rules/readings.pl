:- module(readings,
          [ readings/3,                 % +Goal, -Certain, -Possible
            some/2,                     % ?Visible, :Goal
            maybe/1,                    % :Goal
            settled/4,                  % +Template, :Certain, :Possible, -Bag
            foremost/6,                 % +How, ?Value, ?Template, :Certain, :Possible, +Reading
            ruled/2                     % +Goal, +Reading
          ]).
:- use_module(library(lists)).
:- use_module(library(aggregate)).
:- use_module(library(solution_sequences)).
:- use_module(vocabulary).
:- use_module(goals).
:- use_module(told_words).

/** <module> What is certain and what is possible

A checked goal has two readings: what is known to be true, and what is not known
to be false. A negation swaps them: `\\+ G` is certain when G is not even
possible. A goal is true if its certain reading has an answer, unknown if only
the possible one has, and false otherwise.
*/

:- meta_predicate
    some(?, 0),
    maybe(0),
    settled(+, 0, 0, -),
    foremost(+, ?, ?, 0, 0, +).

%!  readings(+Goal, -Certain, -Possible) is det.
%
%   Two callable goals over the variables of Goal: what is known to be true, and
%   what is not known to be false.

readings(literal(Call, Hidden, Visible), Certain, Possible) :- !,
    certain_literal(Call, Hidden, Visible, Certain),
    possible_literal(Call, Hidden, Visible, Possible).
readings(plain(Call), readings:Call, readings:maybe(readings:Call)) :- !.
readings(and(A, B), (CA, CB), (PA, PB)) :- !,
    readings(A, CA, PA),
    readings(B, CB, PB).
readings(or(A, B), (CA ; CB), (PA ; PB)) :- !,
    readings(A, CA, PA),
    readings(B, CB, PB).
readings(if(A, B, C), (CA -> CB ; \+ PA, CC), (PA, PB ; \+ CA, PC)) :- !,
    readings(A, CA, PA),
    readings(B, CB, PB),
    readings(C, CC, PC).
readings(not(A), \+ PA, \+ CA) :- !,
    readings(A, CA, PA).
readings(all(A, B), \+ ( PA, \+ CB ), \+ ( CA, \+ PB )) :- !,
    readings(A, CA, PA),
    readings(B, CB, PB).
readings(once(A), once(CA), PA) :- !,
    readings(A, CA, PA).
readings(sequence(How, A), Certain, PA) :- !,
    readings(A, CA, PA),
    How =.. List,
    append(List, [CA], Call),
    Certain0 =.. Call,
    Certain = solution_sequences:Certain0.
readings(extreme(How, Value, Template, A), readings:foremost(How, Value, Template, CA, PA, certain),
         readings:foremost(How, Value, Template, CA, PA, possible)) :- !,
    readings(A, CA, PA).
readings(collect(How, Template, A), Certain, Possible) :-
    readings(A, CA, PA),
    Certain = ( readings:settled(Template, CA, PA, Bag), readings:summary(How, Bag) ),
    Possible = ( readings:settled(Template, CA, PA, Bag) -> readings:summary(How, Bag) ; true ).

certain_literal(Call, Hidden, Visible, Certain) :-
    qualified(Call, Goal),
    (   Hidden == []
    ->  Certain = Goal
    ;   Hidden = [First-Class|Others],
        types(Others, OtherTypes),
        FirstType = vocabulary:instance_of(First, Class),
        Certain = readings:some(Visible, readings:joined(Visible, FirstType, Goal, OtherTypes))
    ).

possible_literal(Call, Hidden, Visible, Possible) :-
    (   Call = user_rules:User
    ->  Goal = readings:ruled(User, possible)
    ;   Call = told_words:Told
    ->  Goal = told_words:told_holds(Told, possible)
    ;   Goal = vocabulary:possibly(Call)
    ),
    (   Hidden == []
    ->  Possible = Goal
    ;   possible_types(Hidden, Types),
        Possible = readings:some(Visible, ( Types, Goal ))
    ).

qualified(user_rules:Call, readings:ruled(Call, certain)) :- !.
qualified(told_words:Call, told_words:told_holds(Call, certain)) :- !.
qualified(Call, vocabulary:Call).

types([], true).
types([Variable-Class|Hidden], ( vocabulary:instance_of(Variable, Class), Types )) :-
    types(Hidden, Types).

possible_types([], true).
possible_types([Variable-Class|Hidden], ( vocabulary:possible_instance(Variable, Class), Types )) :-
    possible_types(Hidden, Types).

%   joined(+Visible, +FirstType, +Goal, +OtherTypes): start from what is bound.
joined(Visible, FirstType, Goal, OtherTypes) :-
    (   member(Variable, Visible),
        nonvar(Variable)
    ->  call(Goal),
        call(FirstType),
        call(OtherTypes)
    ;   call(FirstType),
        call(Goal),
        call(OtherTypes)
    ).

%!  some(?Visible, :Goal) is nondet.
%
%   Goal's answers without repetition of Visible: the class names in it stand
%   for some thing, whichever.

some(Visible, Goal) :-
    (   ground(Visible)
    ->  once(Goal)
    ;   distinct(Visible, Goal)
    ).

%!  maybe(:Goal) is nondet.
%
%   Goal, or true where Goal lacks a value that nobody knows.

maybe(Goal) :-
    catch(Goal, error(instantiation_error, _), true).

%!  settled(+Template, :Certain, :Possible, -Bag) is semidet.
%
%   Bag is findall/3 of Certain, if nothing more than that is possible.

settled(Template, Certain, Possible, Bag) :-
    findall(Template, Certain, Bag),
    findall(Template, Possible, All),
    sort(Bag, Set),
    sort(All, AllSet),
    AllSet =@= Set.

%!  foremost(+How, ?Value, ?Template, :Certain, :Possible, +Reading) is nondet.
%
%   The solutions of which Value is `most` or `least`. It is certain of a certain
%   solution when no possible one may have more (or less); it is possible of a
%   possible one that may have as much as every certain one.
%
%   @error type_error(number, Value)

foremost(How, Value, Template, Certain, Possible, Reading) :-
    findall(Value-Template, Certain, Sure),
    best_value(How, Sure, Best),
    findall(Value-Template, Possible, Open),
    (   Reading == certain
    ->  Best \== none,
        \+ ( member(Other-_, Open), may_beat(How, Other, Best) ),
        member(Value-Template, Sure),
        Value =:= Best
    ;   member(Value-Template, Open),
        ( var(Value) ; Best == none ; \+ beats(How, Best, Value) ),
        !
    ).

best_value(How, Pairs, Best) :-
    findall(Value, member(Value-_, Pairs), Values),
    (   Values == []
    ->  Best = none
    ;   How == most
    ->  max_list(Values, Best)
    ;   min_list(Values, Best)
    ).

may_beat(_, Value, _) :- var(Value), !.
may_beat(How, Value, Best) :- beats(How, Value, Best).

beats(most, A, B) :- A > B.
beats(least, A, B) :- A < B.

summary(findall(_, Bag), Bag).
summary(aggregate_all(Spec, Result), Bag) :-
    summarised(Spec, Bag, Result).

summarised(Spec, Bag, Result) :-
    (   Spec == count
    ->  length(Bag, Result)
    ;   copy_term(Spec, Copy),
        aggregate_all(Copy, member(Copy, Bag), Result)
    ).

                /*******************************
                *         USERS' RULES         *
                *******************************/

%!  ruled(+Goal, +Reading) is nondet.
%
%   Goal, a predicate of a user's rule file, in one Reading (`certain` or
%   `possible`) of its clauses. One with a cut in a clause is called as it is.

ruled(Goal, Reading) :-
    (   opaque(Goal)
    ->  call(user_rules:Goal)
    ;   clause(user_rules:Goal, Body),
        body(Body, Reading)
    ).

opaque(Goal) :-
    functor(Goal, Name, Arity),
    functor(Any, Name, Arity),
    clause(user_rules:Any, Body),
    has_cut(Body),
    !.

has_cut(Body) :- var(Body), !, fail.
has_cut(!).
has_cut((A, B)) :- ( has_cut(A) ; has_cut(B) ), !.
has_cut((A ; B)) :- ( has_cut(A) ; has_cut(B) ), !.
has_cut((_ -> A)) :- has_cut(A).

body(Body, Reading) :-
    var(Body),
    !,
    body(call(Body), Reading).
body(true, _) :- !.
body((A, B), Reading) :- !,
    body(A, Reading),
    body(B, Reading).
body((If -> Then ; Else), Reading) :- !,
    opposite(Reading, Opposite),
    (   Reading == certain
    ->  (   body(If, certain)
        ->  body(Then, certain)
        ;   \+ body(If, possible),
            body(Else, certain)
        )
    ;   (   body(If, possible),
            body(Then, possible)
        ;   \+ body(If, Opposite),
            body(Else, possible)
        )
    ).
body((A ; B), Reading) :- !,
    (   body(A, Reading)
    ;   body(B, Reading)
    ).
body((If -> Then), Reading) :- !,
    body((If -> Then ; fail), Reading).
body(\+ A, Reading) :- !,
    opposite(Reading, Opposite),
    \+ body(A, Opposite).
body(forall(A, B), Reading) :- !,
    opposite(Reading, Opposite),
    \+ ( body(A, Opposite), \+ body(B, Reading) ).
body(_:Goal, Reading) :-
    callable(Goal),
    is_word(Goal),
    !,
    body(Goal, Reading).
body(Goal, Reading) :-
    user_word(Goal),
    !,
    ruled(Goal, Reading).
body(Goal, possible) :-
    is_word(Goal),
    !,
    possibly(Goal).
body(Goal, certain) :-
    !,
    call(user_rules:Goal).
body(Goal, possible) :-
    maybe(user_rules:Goal).

is_word(Goal) :-
    functor(Goal, Name, Arity),
    functor(Head, Name, Arity),
    signature(Head, _),
    !.

opposite(certain, possible).
opposite(possible, certain).
