:- module(groups,
          [ group/2,                    % ?Group, -Truth
            grouped/1,                  % ?Group
            members/2,                  % ?Group, -Conditions
            never_seen/2                % ?Group, -Class
          ]).
:- use_module(library(lists)).
:- use_module(facts).
:- use_module(taxonomy).
:- use_module(spatial).

/** <module> Things that together are one: a place setting, a workplace

A group is told by its members and by how they lie: members/2 lists of what
class each is and which relations must hold. A new group is a new clause there
and a word in the vocabulary. Each condition is in three truth values, so that a
group of which a condition is open may be one.
*/

%!  members(?Group, -Conditions:list) is nondet.
%
%   Conditions are is(Thing, Class) and Relation(A, B), in an order in which each
%   but the first begins at a Thing named before.

members(place_setting(Plate, Fork, Knife),
        [ is(Plate, plate), near(Plate, Fork), is(Fork, fork), near(Plate, Knife), is(Knife, knife),
          shared_support(Plate, Fork), shared_support(Plate, Knife) ]).
members(workplace(Desk, Seat, Screen),
        [ is(Desk, working_surface), supports(Desk, Screen), is(Screen, working_device),
          near(Desk, Seat), is(Seat, seat) ]).

%   sort_of(?Sort, ?Class): several classes that a member may be of.
sort_of(working_surface, desk).     sort_of(working_surface, table).    sort_of(working_surface, workbench).
sort_of(working_device, monitor).   sort_of(working_device, computer).  sort_of(working_device, laptop).
sort_of(working_device, keyboard).

%!  grouped(?Group) is nondet.
%
%   Group is a term of members/2.

grouped(Group) :-
    clause(members(Group, _), true).

%!  group(?Group, -Truth) is nondet.
%
%   Group's members are what they must be and lie as they must: true, or unknown
%   where something about it is open. What is known to be none is not enumerated.

group(Group, Truth) :-
    members(Group, Conditions),
    conditions(Conditions, true, Truth),
    Group =.. [_|Members],
    sort(Members, Different),
    length(Members, Number),
    length(Different, Number).

conditions([], Truth, Truth).
conditions([Condition|Conditions], Before, Truth) :-
    condition(Condition, One),
    both(Before, One, Now),
    conditions(Conditions, Now, Truth).

both(true, Truth, Truth) :- !.
both(unknown, _, unknown).

condition(is(Thing, Sort), true) :-
    (   nonvar(Thing)
    ->  once(of_sort(Thing, Sort))
    ;   setof(T, of_sort(T, Sort), Things),
        member(Thing, Things)
    ).
condition(near(A, B), Truth) :-
    judged(near, A, B, Truth, _),
    Truth \== false.
condition(near(A, B), true) :-
    edge(near, A, B, _, _, _).
condition(supports(A, B), Truth) :-
    judged(on, B, A, Truth, _),
    Truth \== false.
condition(supports(A, B), true) :-
    edge(on, B, A, _, _, _).
condition(shared_support(A, B), Truth) :-
    (   rests(A, Support, true),
        rests(B, Support, true)
    ->  Truth = true
    ;   rests(A, Support, _),
        rests(B, Support, _)
    ->  Truth = unknown
    ;   \+ rests(A, _, _)                % on what it lies was never measured
    ->  Truth = unknown
    ;   \+ rests(B, _, _),
        Truth = unknown
    ).

rests(A, Support, Truth) :-
    judged(on, A, Support, Truth, _),
    Truth \== false.
rests(A, Support, true) :-
    edge(on, A, Support, _, _, _).

%!  never_seen(?Group, -Class) is nondet.
%
%   A member of Group must be a Class, or one of several, of which none is known.

never_seen(Group, Sort) :-
    members(Group, Conditions),
    member(is(_, Sort), Conditions),
    \+ of_sort(_, Sort).

of_sort(Thing, Sort) :-
    (   sort_of(Sort, Class)
    *-> true
    ;   Class = Sort
    ),
    labelled(Thing, Class).
