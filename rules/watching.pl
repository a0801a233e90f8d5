:- module(watching,
          [ ask_noting/3                % +Watches, +Seconds, -Replies
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(pairs)).
:- use_module(library(prolog_wrap)).
:- use_module(facts).
:- use_module(ask).
:- use_module(goals, [read_goal/4]).

/** <module> Asking, and noting which facts were read

What a goal is answered with follows from the facts that were looked up on the
way, whatever rules led there. While a watched goal runs, the predicates of
facts.pl are wrapped so that each look-up is noted by the predicate and one name
that was given in it: an id, a class, a key, a relation. Only a change of a fact
with that name (or of any fact of the predicate, where no name was given) can
change the answers.
*/

%!  ask_noting(+Watches:list, +Seconds, -Replies:list) is det.
%
%   Ask the goals of Watches, watch(Id, Text, Options, Pin, Known) with Text and
%   Options as in ask/3, one after the other until Seconds have passed; at least
%   the first is asked. Pin is `any`, or pin(Things): only where the class that the
%   goal begins with is one of these Things. Replies is a list of
%   asked(Id, Reply, Seconds, Reads, Class): the time that it took, and for
%   each predicate that was read a list of its name and the names that it was
%   read with, `*` where none was given; `same` where it read as the last time and
%   Known is `true`. Class is the one that the goal begins with, where it read so
%   much that it is better asked for a few things at a time, else `none`.

ask_noting(Watches, Seconds, Replies) :-
    get_time(Start),
    Deadline is Start+Seconds,
    findall(Head-Names, names_in(Head, Names), Facts),
    setup_call_cleanup(
        maplist(wrap, Facts),
        ask_until(Watches, Deadline, Replies),
        maplist(let_through, Facts)).

ask_until([], _, []).
ask_until([watch(Id, Text, Options, Pin, Known)|Watches], Deadline, [asked(Id, Reply, Took, Reads, Class)|Replies]) :-
    get_time(Start),
    setup_call_cleanup(
        trie_new(Noted),
        ( nb_setval(watching_noted, Noted),
          forget_derived,
          ask_as(pinned(Pin), Text, Options, Reply),
          reads(Id, Noted, Known, Reads, Number),
          ( Pin == any, much(Much), Number > Much, catch(begins_with(Text, Class0), _, fail)
          ->  Class = Class0
          ;   Class = none
          ) ),
        trie_destroy(Noted)),
    get_time(Now),
    Took is Now-Start,
    (   Now < Deadline
    ->  ask_until(Watches, Deadline, Replies)
    ;   Replies = []
    ).

%   forget_derived: what was worked out before and kept would hide what it was worked out from.
forget_derived :-
    new_revision.

wrap(Head-Names) :-
    functor(Head, Predicate, _),
    first_given(Names, Name, Choice),
    wrap_predicate(facts:Head, watching, Look,
                   ( Choice,
                     nb_getval(watching_noted, Noted),
                     ( trie_insert(Noted, Predicate-Name) -> true ; true ),
                     Look )).

%   first_given(+Arguments, -Name, -Choice): Choice is a goal that binds Name to the first argument that is an atom.
first_given([], Name, Name = (*)).
first_given([Argument|Arguments], Name, ( atom(Argument) -> Name = Argument ; Otherwise )) :-
    first_given(Arguments, Name, Otherwise).

%   A wrapper is left in place, since unwrap_predicate/2 of SWI-Prolog 9.0 gives back an atom that was not taken.
let_through(Head-_) :-
    wrap_predicate(facts:Head, watching, Look, Look).

%   names_in(?Head, ?Names): the arguments of a fact that may name it, the most telling first.
names_in(node(Id, Layer), [Id, Layer]).
names_in(label(Id, Class), [Id, Class]).
names_in(named(Id, _), [Id]).
names_in(position(Id, _, _, _), [Id]).
names_in(size(Id, _, _, _), [Id]).
names_in(yaw(Id, _), [Id]).
names_in(outline(Id, _), [Id]).
names_in(confidence(Id, _), [Id]).
names_in(seen(Id, _, _), [Id]).
names_in(attribute(Id, Key, Value), [Id, Value, Key]).
names_in(told(Term), [Term]).
names_in(class_info(Class, _, Parent), [Class, Parent]).
names_in(parameter(Name, _), [Name]).
names_in(unobserved(Region), [Region]).
names_in(stored_edge(A, B, Relation, _, _, _), [A, B, Relation]).
names_in(store(Name, _, _), [Name]).
names_in(lasted(Relation, A, B, _, _), [A, B, Relation]).
names_in(lived(Id, _, Class, _, _), [Id, Class]).
names_in(had(Id, Key, _, _, _), [Id, Key]).
names_in(event(Kind, Id, _, _, _), [Id, Kind]).
names_in(sighted(Id, _, _), [Id]).
names_in(past_relation(Name), [Name]).
names_in(told_past(Name), [Name]).
names_in(Head, [Id]) :-
    facts:store(_, 3, Predicate),
    Head =.. [Predicate, Id, _].
names_in(Head, [A, B]) :-
    facts:store(_, 4, Predicate),
    Head =.. [Predicate, A, B, _].

:- dynamic told_reads/2.                % Id, SHA-1 of the sorted look-ups

%!  reads(+Id, +Noted, +Known, -Reads, -Number) is det.
%
%   What was looked up, or `same` where that is what was told of Id before and is
%   Known; and how much it is.

reads(Id, Noted, Known, Reads, Number) :-
    findall(Look, trie_gen(Noted, Look), Looks0),
    length(Looks0, Number),
    sort(Looks0, Looks),
    variant_sha1(Looks, Hash),
    (   Known == true,
        told_reads(Id, Hash)
    ->  Reads = same
    ;   retractall(told_reads(Id, _)),
        assertz(told_reads(Id, Hash)),
        group_pairs_by_key(Looks, Groups),
        findall([Predicate|Names], member(Predicate-Names, Groups), Reads)
    ).

                /*******************************
                *     A FEW THINGS AT A TIME   *
                *******************************/

%!  much(-Number) is det.
%
%   A goal that looks up more is asked for a few things at a time, if it can.

:- dynamic much/1.
much(1000).

%   begins_with(+Text, -Class): a conjunction is begun with things of a class, cup(X) or near(cup, Y).
begins_with(Text, Class) :-
    read_goal(Text, Goal, _, _),
    first_literal(Goal, Literal),
    (   Literal = literal(instance_of(X, Class0), [], _),
        var(X),
        atom(Class0)
    ->  Class = Class0
    ;   Literal = literal(_, [_-Class|_], _)
    ).

first_literal(and(A, _), Literal) :- !,
    first_literal(A, Literal).
first_literal(Literal, Literal) :-
    Literal = literal(_, _, _).

%!  pinned(+Pin, +Goal, -Pinned) is det.

pinned(any, Goal, Goal).
pinned(pin(Things), Goal, and(plain(member(Thing, Things)), Rest)) :-
    pinned_to(Goal, Thing, Rest).

%   pinned_to(+Goal, -Thing, -Rest): Rest is Goal for a Thing of the class that it begins with.
pinned_to(and(A, B), Thing, and(Rest, B)) :- !,
    pinned_to(A, Thing, Rest).
pinned_to(literal(Call, [Thing-_|Hidden], Visible), Thing, literal(Call, Hidden, Visible)) :- !.
pinned_to(literal(instance_of(Thing, Class), [], Visible), Thing, literal(instance_of(Thing, Class), [], Visible)).
