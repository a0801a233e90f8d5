:- module(history,
          [ holds/2,                    % +State, +Moment
            held/3,                     % +State, ?From, ?To
            allen/3,                    % ?Relation, +A, +B
            allen_relation/1,           % ?Relation
            before/2, after/2, meets/2, met_by/2, overlaps/2, overlapped_by/2, starts/2, started_by/2,
            during/2, encloses/2, finishes/2, finished_by/2, equals/2,
            last_seen/2,                % ?Thing, ?Moment
            changed_since/2,            % +Moment, ?Event
            moment/2,                   % ?Name, ?Ns
            past_argument/3,            % +Kind, +Argument, -Read
            past_word/1,                % +Goal
            possibly_past/1,            % +Goal
            past_reason/3,              % +Goal, -Truth, -Evidence
            past_miss/4                 % +Goal, -Distance, -Tests, -Evidence
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(facts).
:- use_module(taxonomy, [class/1, subclass/2]).
:- use_module(names).

/** <module> What held when

The graph remembers from when to when its edges, labels and attributes were
there; the facts lasted/5, lived/5 and had/5 say so for the relations that
somebody asked about. An interval is half open, From =< T < To, in nanoseconds,
and To is `now` for what still holds. An instant, such as an event, is the
interval of one nanosecond.

    ?- holds(on(cup_1, X), ago(600)).
    ?- held(in(cup_1, R), From, To).
    ?- before(on(cup_1, table_1), in(cup_1, room_2)).
    ?- changed_since(breakfast, ended(on(cup, X))).

Nothing is known of the time before a thing was first observed: what is asked of
it is then unknown, not false.
*/

                /*******************************
                *           MOMENTS            *
                *******************************/

%!  moment(?Name, ?Ns) is nondet.
%
%   Name stands for a moment: `now` is when the graph last changed, `start` when
%   what is remembered of it began; an operator may tell others,
%   fact(moment(breakfast, 1700000000000000000)).

moment(now, Ns) :- parameter(now_ns, Ns).
moment(start, Ns) :- parameter(history_since_ns, Ns).
moment(Name, Ns) :- told(moment(Name, Ns)), integer(Ns).

%   instant(+Moment, -Ns): a number of nanoseconds, a name, ago(Seconds), or an event, which may have happened often.
instant(Moment, _) :-
    var(Moment),
    !,
    throw(problem(unbound_variable, "a moment was asked for that has no value",
                  "give nanoseconds, now, ago(Seconds) or a moment that was told")).
instant(Moment, Ns) :- integer(Moment), !, Ns = Moment.
instant(Moment, Ns) :- number(Moment), !, Ns is round(Moment).
instant(ago(Seconds), Ns) :- !, needs(nothing), moment(now, Now), Ns is Now-round(Seconds*1.0e9).
instant(Name, Ns) :- atom(Name), !, needs(nothing), moment(Name, Ns).
instant(Event, Ns) :- happened(Event, Ns).

                /*******************************
                *            STATES            *
                *******************************/

%!  holds(+State, +Moment) is nondet.
%
%   State held at Moment. A moment after the last change of the graph means that.

holds(State, Moment) :-
    instant(Moment, Ns),
    spell(State, at(Ns), From, To),
    includes(From, To, Ns).

includes(From, To, Ns) :-
    From =< Ns,
    ( To == now -> true ; Ns < To ).

%!  held(+State, ?From, ?To) is nondet.
%
%   State held from From until To [ns], which is `now` when it still does.

held(State, From, To) :-
    spell(State, ever, From, To).

%   needs(+What): what the rules were told of the past; the service tells more, and asks again.
needs(What) :-
    (   parameter(history_since_ns, _),
        ( What == nothing ; told_past(What) ; told_past(all) )
    ->  true
    ;   format(string(Message), "nothing is remembered here of what held before (~w)", [What]),
        throw(problem(needs_past, Message, What))
    ).

%   spell(+State, +When, -From, -To): each interval in which State held, for things that were of the classes in it
%   at(Ns), or ever.
spell(State, _, _, _) :-
    var(State),
    !,
    throw(problem(unbound_variable, "a fact was asked for without saying which", "such as on(X, Y)")).
spell(label(Thing, Class), When, From, To) :- !,
    needs(nothing),
    given(Thing, Id),
    lived(Id, _, Class, From, To),
    is_it(Thing, Id, When).
spell(instance_of(Thing, Class), When, From, To) :- !,
    needs(nothing),
    given(Thing, Id),
    of_class(Class, Id, From, To),
    is_it(Thing, Id, When).
spell(node(Thing, Layer), When, From, To) :- !,
    needs(nothing),
    given(Thing, Id),
    lived(Id, Layer, _, First, _),
    \+ ( lived(Id, _, _, _, Earlier), Earlier == First ),
    From = First,
    end_of_life(Id, First, To),
    is_it(Thing, Id, When).
spell(attribute(Thing, Key, Value), When, From, To) :- !,
    needs(nothing),
    given(Thing, Id),
    had(Id, Key, Value, From, To),
    is_it(Thing, Id, When).
spell(named(Thing, Name), When, From, To) :- !,
    spell(attribute(Thing, name, Name), When, From, To).
spell(Relation, When, From, To) :-
    compound_name_arguments(Relation, Name, [A, B]),
    needs(Name),
    given(A, IdA),
    given(B, IdB),
    lasted(Name, IdA, IdB, From, To),
    is_it(A, IdA, When),
    is_it(B, IdB, When).

%   given(+Thing, -Id): Id is known where Thing is one id.
given(Thing, Id) :-
    ( atom(Thing) -> Id = Thing ; true ).

%   is_it(?Thing, +Id, +When): Thing is Id, or any(Class) that Id carried.
is_it(Thing, Id, When) :-
    (   nonvar(Thing),
        Thing = any(Class)
    ->  once(( of_class(Class, Id, From, To), ( When = at(Ns) -> includes(From, To, Ns) ; true ) ))
    ;   Thing = Id
    ).

%   of_class(?Class, ?Id, -From, -To): Id carried Class, or one below it, or was in the layer Class, or went by that name.
of_class(Class, Id, From, To) :-
    nonvar(Id),
    !,
    (   lived(Id, Layer, Label, From, To),
        once(( subclass(Label, Class) ; Layer = Class ))
    ;   went_by(Id, Class, From, To)
    ).
of_class(Class, Id, From, To) :-
    nonvar(Class),
    !,
    (   subclass(Label, Class),
        lived(Id, _, Label, From, To)
    ;   lived(Id, Class, Label, From, To),
        \+ subclass(Label, Class)
    ;   went_by(Id, Class, From, To)
    ).
of_class(Class, Id, From, To) :-
    lived(Id, _, Label, From, To),
    subclass(Label, Class).

went_by(Id, Atom, From, To) :-
    nonvar(Atom),
    had(Id, name, Name, From, To),
    name_atom(Name, Atom).

%   A life with another label goes on.
end_of_life(Id, From, To) :-
    lived(Id, _, _, From, End),
    (   integer(End),
        lived(Id, _, _, End, _)
    ->  end_of_life(Id, End, To)
    ;   To = End
    ).

%!  last_seen(?Thing, ?Ns) is nondet.
%
%   Thing, which may have gone since, was seen last at Ns.

last_seen(Thing, Ns) :-
    needs(nothing),
    given(Thing, Id),
    (   seen(Id, _, Ns)
    ;   sighted(Id, _, Ns),
        \+ node(Id, _)
    ),
    is_it(Thing, Id, ever).

                /*******************************
                *            EVENTS            *
                *******************************/

%!  changed_since(+Moment, ?Event) is nondet.
%
%   Event happened later than Moment: appeared(X), moved(X), vanished(X),
%   merged(X, Into), split(X, From), relabelled(X, Was, Is), began(State) or
%   ended(State).

changed_since(Moment, Event) :-
    instant(Moment, Since),
    happened(Event, Ns),
    Ns > Since.

%   happened(?Event, -Ns)
happened(Event, Ns) :-
    var(Event),
    !,
    needs(all),
    (   event(Kind, Id, Ns, Other, Was),
        event_term(Kind, Id, Other, Was, Event)
    ;   lasted(Relation, A, B, From, To),
        State =.. [Relation, A, B],
        (   Event = began(State), Ns = From
        ;   Event = ended(State), integer(To), Ns = To
        )
    ).
happened(began(State), Ns) :- !,
    spell(State, ever, Ns, _).
happened(ended(State), Ns) :- !,
    spell(State, ever, _, Ns),
    integer(Ns).
happened(Event, Ns) :-
    needs(nothing),
    event_term(Kind, Read, Other, Was, Event),
    given(Read, Id),
    event(Kind, Id, Ns, Other, Was),
    is_it(Read, Id, ever).

event_term(appeared, Id, _, _, appeared(Id)).
event_term(moved, Id, _, _, moved(Id)).
event_term(vanished, Id, _, _, vanished(Id)).
event_term(merged, Id, Into, _, merged(Id, Into)).
event_term(split, Id, From, _, split(Id, From)).
event_term(relabelled, Id, Is, Was, relabelled(Id, Was, Is)).

                /*******************************
                *       ALLEN'S ALGEBRA        *
                *******************************/

%!  allen_relation(?Relation) is nondet.
%
%   Relation is one of the thirteen between two intervals (Allen 1983); his
%   `contains` is called `encloses`, since things contain things here.

allen_relation(Relation) :-
    allen_test(Relation, _).

%   allen_test(?Relation, -Tests): which ends compare how; a and b begin, z and y end the first and the second.
allen_test(before,        [z < b]).
allen_test(after,         [y < a]).
allen_test(meets,         [z = b]).
allen_test(met_by,        [y = a]).
allen_test(overlaps,      [a < b, b < z, z < y]).
allen_test(overlapped_by, [b < a, a < y, y < z]).
allen_test(starts,        [a = b, z < y]).
allen_test(started_by,    [a = b, y < z]).
allen_test(during,        [b < a, z < y]).
allen_test(encloses,      [a < b, y < z]).
allen_test(finishes,      [b < a, z = y]).
allen_test(finished_by,   [a < b, z = y]).
allen_test(equals,        [a = b, z = y]).

%!  allen(?Relation, +A, +B) is nondet.
%
%   Relation holds for certain between an interval of A and one of B: facts,
%   seen(Thing), events, interval(Moment, Moment) or moments. What still holds
%   will end some time after now, nobody knows when.

allen(Relation, A, B) :-
    allen(Relation, A, B, true).

allen(Relation, A, B, Truth) :-
    interval(A, FromA, ToA),
    interval(B, FromB, ToB),
    ( same_spell(A, FromA, ToA, B, FromB, ToB) -> Same = true ; Same = false ),
    allen_test(Relation, Tests),
    allen_truth(Tests, ends(FromA, ToA, FromB, ToB, Same), Truth).

same_spell(A, From, now, B, From, now) :- A == B.

allen_truth(Tests, Ends, Truth) :-
    maplist(end_truth(Ends), Tests, Truths),
    (   memberchk(false, Truths)
    ->  Truth0 = false
    ;   memberchk(unknown, Truths)
    ->  Truth0 = unknown
    ;   Truth0 = true
    ),
    Truth = Truth0.

end_truth(Ends, Test, Truth) :-
    Test =.. [Order, X, Y],
    end(X, Ends, EndX),
    end(Y, Ends, EndY),
    arg(5, Ends, Same),
    compared(EndX, EndY, Same, Possible),
    (   Possible == [Order]
    ->  Truth = true
    ;   memberchk(Order, Possible)
    ->  Truth = unknown
    ;   Truth = false
    ).

end(a, ends(A, _, _, _, _), A).
end(z, ends(_, Z, _, _, _), Z).
end(b, ends(_, _, B, _, _), B).
end(y, ends(_, _, _, Y, _), Y).

%   compared(+X, +Y, +Same, -Possible): the orders that two ends may have; one that is open lies after now.
compared(now, now, true, [=]) :- !.
compared(now, now, false, [<, =, >]) :- !.
compared(now, Y, _, Possible) :- !,
    moment(now, Now),
    ( Y =< Now -> Possible = [>] ; Possible = [<, =, >] ).
compared(X, now, _, Possible) :- !,
    moment(now, Now),
    ( X =< Now -> Possible = [<] ; Possible = [<, =, >] ).
compared(X, Y, _, [Order]) :-
    compare(Order, X, Y).

%   interval(+Occurrence, -From, -To)
interval(Occurrence, _, _) :-
    var(Occurrence),
    !,
    throw(problem(unbound_variable, "an interval was asked for without saying of what", "such as on(X, Y)")).
interval(interval(M1, M2), From, To) :- !,
    instant(M1, From),
    instant(M2, To),
    From < To.
interval(seen(Thing), From, To) :- !,
    needs(nothing),
    given(Thing, Id),
    (   seen(Id, From, Last)
    ;   sighted(Id, From, Last),
        \+ node(Id, _)
    ),
    is_it(Thing, Id, ever),
    To is Last+1.
interval(Event, From, To) :-
    ( event_term(_, _, _, _, Event) ; Event = began(_) ; Event = ended(_) ),
    !,
    happened(Event, From),
    To is From+1.
interval(Moment, From, To) :-
    ( atomic(Moment) ; Moment = ago(_) ),
    !,
    instant(Moment, From),
    To is From+1.
interval(State, From, To) :-
    spell(State, ever, From, To).

%!  before(+A, +B) is nondet.
%
%   An interval of A ends before one of B begins.

before(A, B) :-
    allen(before, A, B).

%!  after(+A, +B) is nondet.
%
%   An interval of A begins after one of B has ended.

after(A, B) :-
    allen(after, A, B).

%!  meets(+A, +B) is nondet.
%
%   An interval of A ends when one of B begins.

meets(A, B) :-
    allen(meets, A, B).

%!  met_by(+A, +B) is nondet.
%
%   An interval of A begins when one of B ends.

met_by(A, B) :-
    allen(met_by, A, B).

%!  overlaps(+A, +B) is nondet.
%
%   An interval of A begins first and ends within one of B.

overlaps(A, B) :-
    allen(overlaps, A, B).

%!  overlapped_by(+A, +B) is nondet.
%
%   An interval of A begins within one of B and ends last.

overlapped_by(A, B) :-
    allen(overlapped_by, A, B).

%!  starts(+A, +B) is nondet.
%
%   An interval of A begins with one of B and ends before that one.

starts(A, B) :-
    allen(starts, A, B).

%!  started_by(+A, +B) is nondet.
%
%   An interval of A begins with one of B and ends after that one.

started_by(A, B) :-
    allen(started_by, A, B).

%!  during(+A, +B) is nondet.
%
%   An interval of A begins after one of B and ends before that one.

during(A, B) :-
    allen(during, A, B).

%!  encloses(+A, +B) is nondet.
%
%   An interval of A begins before one of B and ends after that one.

encloses(A, B) :-
    allen(encloses, A, B).

%!  finishes(+A, +B) is nondet.
%
%   An interval of A begins after one of B and ends with that one.

finishes(A, B) :-
    allen(finishes, A, B).

%!  finished_by(+A, +B) is nondet.
%
%   An interval of A begins before one of B and ends with that one.

finished_by(A, B) :-
    allen(finished_by, A, B).

%!  equals(+A, +B) is nondet.
%
%   An interval of A begins and ends with one of B.

equals(A, B) :-
    allen(equals, A, B).

                /*******************************
                *       WHAT MAY BE TRUE       *
                *******************************/

%!  past_word(+Goal) is semidet.
%
%   Goal is asked of the past.

past_word(Goal) :-
    (   memberchk(Goal, [holds(_, _), held(_, _, _), allen(_, _, _), last_seen(_, _), changed_since(_, _)])
    ->  true
    ;   as_allen(Goal, _, _, _)
    ).

as_allen(allen(Relation, A, B), Relation, A, B) :- !.
as_allen(Goal, Relation, A, B) :-
    compound_name_arguments(Goal, Relation, [A, B]),
    allen_relation(Relation),
    !.

%!  possibly_past(+Goal) is nondet.
%
%   Goal is not known to be false: it holds, or it is about a time before its
%   things were observed, or it hangs on when something will end.

possibly_past(holds(State, Moment)) :- !,
    (   holds(State, Moment)
    ;   instant(Moment, Ns),
        unobserved_at(State, Ns)
    ).
possibly_past(held(State, From, To)) :- !,
    held(State, From, To).
possibly_past(changed_since(Moment, Event)) :- !,
    (   changed_since(Moment, Event)
    ;   instant(Moment, Ns),
        moment(start, Start),
        Ns < Start
    ).
possibly_past(last_seen(Thing, Ns)) :- !,
    last_seen(Thing, Ns).
possibly_past(Goal) :-
    as_allen(Goal, Relation, A, B),
    allen(Relation, A, B, Truth),
    Truth \== false.

%   unobserved_at(+State, +Ns): nobody had seen what State is about.
unobserved_at(_, Ns) :-
    moment(start, Start),
    Ns < Start,
    !.
unobserved_at(State, Ns) :-
    compound_name_arguments(State, _, Arguments),
    member(Thing, Arguments),
    nonvar(Thing),
    (   Thing = any(Class)
    ->  unobserved(world),
        \+ ( of_class(Class, _, From, To), includes(From, To, Ns) )
    ;   atom(Thing),
        ever(Thing),
        \+ ( lived(Thing, _, _, From, To), includes(From, To, Ns) )
    ),
    !.

ever(Id) :- lived(Id, _, _, _, _), !.

                /*******************************
                *             WHY              *
                *******************************/

%!  past_reason(+Goal, -Truth, -Evidence:list) is semidet.
%
%   From when to when what Goal, with its values, is about held.

past_reason(holds(State, Moment), true, [held(State, From, To)]) :-
    instant(Moment, Ns),
    spell(State, at(Ns), From, To),
    includes(From, To, Ns),
    !.
past_reason(holds(State, Moment), unknown, Evidence) :- !,
    instant(Moment, Ns),
    unobserved_at(State, Ns),
    findall(first_observed(Id, From), ( arg(_, State, Id), atom(Id), first_observed(Id, From) ), Evidence).
past_reason(changed_since(Moment, Event), true, [at(Event, Ns)]) :- !,
    instant(Moment, Since),
    happened(Event, Ns),
    Ns > Since,
    !.
past_reason(last_seen(Thing, Ns), true, [seen(Thing, First, Ns)]) :- !,
    ( seen(Thing, First, Ns) ; sighted(Thing, First, Ns) ),
    !.
past_reason(Goal, Truth, [held(A, FromA, ToA), held(B, FromB, ToB)]) :-
    as_allen(Goal, Relation, A, B),
    member(Truth, [true, unknown]),
    interval(A, FromA, ToA),
    interval(B, FromB, ToB),
    ( same_spell(A, FromA, ToA, B, FromB, ToB) -> Same = true ; Same = false ),
    allen_test(Relation, Tests),
    allen_truth(Tests, ends(FromA, ToA, FromB, ToB, Same), Truth),
    !.

first_observed(Id, First) :-
    findall(From, lived(Id, _, _, From, _), Froms),
    min_list(Froms, First).

%!  past_miss(+Goal, -Distance, -Tests:list, -Evidence:list) is nondet.
%
%   A time at which Goal would hold, and how far that is away [s].

past_miss(holds(State, Moment), Distance, [test(moment, Ns, Comparison, End, Limit)], [held(State, From, To)]) :-
    instant(Moment, Ns),
    spell(State, ever, From, To),
    (   Ns < From
    ->  Comparison = (>=), End = held_from, Limit = From
    ;   Comparison = (<), End = held_until, Limit = To
    ),
    Distance is abs(Ns-Limit)/1.0e9.
past_miss(Goal, 0, [], [held(A, FromA, ToA), held(B, FromB, ToB)]) :-
    as_allen(Goal, _, A, B),
    interval(A, FromA, ToA),
    interval(B, FromB, ToB).

                /*******************************
                *           READING            *
                *******************************/

%!  past_argument(+Kind, +Argument, -Read) is det.
%
%   Read is Argument with any(Class) for the class names in it. Kind is `state`,
%   `occurrence`, `event`, `moment` or `once` (a thing that is or was).
%
%   @error problem(Code, Message, Hint)

past_argument(_, Argument, Argument) :-
    var(Argument),
    !.
past_argument(once, Thing, Read) :-
    atom(Thing),
    !,
    (   ( node(Thing, _) ; ever(Thing) )
    ->  Read = Thing
    ;   ( known_kind(Thing) ; layer(Thing) )
    ->  Read = any(Thing)
    ;   needs(nothing),
        findall(Known, ( node(Known, _) ; lived(Known, _, _, _, _) ; class(Known) ), Names),
        unknown_name(Thing, Names)
    ).
past_argument(moment, Moment, Moment) :-
    ( number(Moment) ; Moment = ago(Seconds), number(Seconds) ),
    !.
past_argument(moment, Moment, Moment) :-
    atom(Moment),
    !,
    needs(nothing),
    (   moment(Moment, _)
    ->  true
    ;   findall(Name, moment(Name, _), Names),
        unknown_name(Moment, Names)
    ).
past_argument(moment, Event, Read) :-
    past_argument(event, Event, Read),
    !.
past_argument(event, Event, Read) :-
    compound_name_arguments(Event, Word, [State]),
    memberchk(Word, [began, ended]),
    !,
    past_argument(state, State, ReadState),
    compound_name_arguments(Read, Word, [ReadState]).
past_argument(event, Event, Read) :-
    event_term(_, _, _, _, Event),
    !,
    Event =.. [Word, Thing|More],
    past_argument(once, Thing, ReadThing),
    Read =.. [Word, ReadThing|More].
past_argument(occurrence, interval(M1, M2), interval(R1, R2)) :- !,
    past_argument(moment, M1, R1),
    past_argument(moment, M2, R2).
past_argument(occurrence, seen(Thing), seen(Read)) :- !,
    past_argument(once, Thing, Read).
past_argument(occurrence, Moment, Read) :-
    ( atomic(Moment) ; Moment = ago(_) ),
    !,
    past_argument(moment, Moment, Read).
past_argument(occurrence, Event, Read) :-
    past_argument(event, Event, Read),
    !.
past_argument(occurrence, State, Read) :- !,
    past_argument(state, State, Read).
past_argument(state, State, Read) :-
    compound(State),
    compound_name_arguments(State, Name, Arguments),
    state(Name, Arguments, Read),
    !.
past_argument(Kind, Argument, _) :-
    Kind \== event,
    format(string(Message), "~q is not a ~w that has a history", [Argument, Kind]),
    throw(problem(bad_argument, Message, "such as on(cup_1, X), in(X, room_2), object(X), attribute(X, open, true)")).

state(label, [Thing, Class], label(Read, Class)) :- past_argument(once, Thing, Read).
state(instance_of, [Thing, Class], instance_of(Read, Class)) :- past_argument(once, Thing, Read).
state(node, [Thing, Layer], node(Read, Layer)) :- past_argument(once, Thing, Read).
state(attribute, [Thing, Key, Value], attribute(Read, Key, Value)) :- past_argument(once, Thing, Read).
state(named, [Thing, Name], named(Read, Name)) :- past_argument(once, Thing, Read).
state(Layer, [Thing], node(Read, Layer)) :- layer(Layer), past_argument(once, Thing, Read).
state(Class, [Thing], instance_of(Read, Class)) :- known_kind(Class), past_argument(once, Thing, Read).
state(Name, [A, B], Read) :-
    kept_relation(Name),
    past_argument(once, A, ReadA),
    past_argument(once, B, ReadB),
    Read =.. [Name, ReadA, ReadB].

layer(Layer) :-
    memberchk(Layer, [building, storey, room, place, object, structure, agent]).

known_kind(Class) :-
    class(Class),
    !.
known_kind(Class) :-
    lived(_, _, Class, _, _),
    !.
known_kind(Name) :-
    went_by(_, Name, _, _),
    !.

%   kept_relation(?Name): the graph keeps edges of this name.
kept_relation(Name) :-
    memberchk(Name, [ on, supports, in, contains, above, under, near, touching, next_to, attached_to, hanging_from,
                      part_of, connects, adjacent ]),
    !.
kept_relation(Name) :-
    past_relation(Name),
    !.
