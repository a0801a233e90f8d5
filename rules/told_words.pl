:- module(told_words,
          [ told_word/4,                % ?Head, -Kinds, -Documentation, -Rules
            told_holds/2,               % +Head, +Reading
            told_clause/3               % +Head, -Goal, -Names
          ]).

/** <module> Words that were defined by rules that somebody told

What told_rules.pl accepted is kept here, as data: heads with checked goals, in
the two readings that readings.pl makes of them. No clause of theirs is ever part
of a program.
*/

:- dynamic
    word/4,                             % Head, Kinds, Documentation, Rules
    stored_rule/6.                             % Head, Rules, Certain, Possible, Goal, Names

%!  told_word(?Head, -Kinds, -Documentation, -Rules) is nondet.
%
%   Head, with variables as arguments, is a word that Rules define; Kinds are the
%   kinds of its arguments, as in signature/2.

told_word(Head, Kinds, Documentation, Rules) :-
    word(Head, Kinds, Documentation, Rules).

%!  told_holds(+Head, +Reading) is nondet.
%
%   Head follows from what was told, in one Reading: `certain` or `possible`.

told_holds(Head, certain) :-
    stored_rule(Head, _, Certain, _, _, _),
    call(Certain).
told_holds(Head, possible) :-
    stored_rule(Head, _, _, Possible, _, _),
    call(Possible).

%!  told_clause(+Head, -Goal, -Names) is nondet.
%
%   Head holds where the checked Goal does; Names are its variables' names.

told_clause(Head, Goal, Names) :-
    stored_rule(Head, _, _, _, Goal, Names).
