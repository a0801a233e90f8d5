:- module(home, [ tell/1, with/1 ]).
:- use_module(library(lists)).
:- use_module(library(apply)).

/** <module> Facts for the tests of the rules */

:- use_module(rules(facts)).

%!  tell(+Facts:list) is det.
%
%   Put Facts where they belong.

tell(Facts) :-
    with_output_to(string(Text), forall(member(Fact, Facts), format("put(~q).~n", [Fact]))),
    setup_call_cleanup(open_string(Text, Stream), update(Stream), close(Stream)).

%!  with(+Facts:list) is det.
%
%   A world in which nothing but Facts is known.

with(Facts) :-
    forget_everything,
    tell(Facts).
