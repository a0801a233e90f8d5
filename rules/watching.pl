:- module(watching,
          [ ask_noting/3                % +Watches, +Seconds, -Replies
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(pairs)).
:- use_module(library(prolog_wrap)).
:- use_module(facts).
:- use_module(ask).

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
%   Ask the goals of Watches, watch(Id, Text, Options) as in ask/3, one after
%   the other until Seconds have passed; at least the first is asked. Replies is
%   a list of asked(Id, Reply, Seconds, Reads): the time that it took, and for
%   each predicate that was read a list of its name and the names that it was
%   read with, `*` where none was given; `same` where it read as the last time.

ask_noting(Watches, Seconds, Replies) :-
    get_time(Start),
    Deadline is Start+Seconds,
    findall(Head-Names, names_in(Head, Names), Facts),
    setup_call_cleanup(
        maplist(wrap, Facts),
        ask_until(Watches, Deadline, Replies),
        maplist(let_through, Facts)).

ask_until([], _, []).
ask_until([watch(Id, Text, Options)|Watches], Deadline, [asked(Id, Reply, Took, Reads)|Replies]) :-
    get_time(Start),
    setup_call_cleanup(
        trie_new(Noted),
        ( nb_setval(watching_noted, Noted),
          forget_derived,
          ask(Text, Options, Reply),
          reads(Id, Noted, Reads) ),
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

%!  reads(+Id, +Noted, -Reads) is det.
%
%   What was looked up, or `same` where that is what was told of Id before.

reads(Id, Noted, Reads) :-
    findall(Look, trie_gen(Noted, Look), Looks0),
    sort(Looks0, Looks),
    variant_sha1(Looks, Hash),
    (   told_reads(Id, Hash)
    ->  Reads = same
    ;   retractall(told_reads(Id, _)),
        assertz(told_reads(Id, Hash)),
        group_pairs_by_key(Looks, Groups),
        findall([Predicate|Names], member(Predicate-Names, Groups), Reads)
    ).
