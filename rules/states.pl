:- module(states,
          [ open/1,                     % ?Id
            closed/1,                   % ?Id
            switched_on/1,              % ?Id
            switched_off/1,             % ?Id
            holding/1,                  % ?Id
            holding/2,                  % ?Robot, ?Id
            poured/2,                   % ?From, ?Into
            possible_state/1,           % +Goal
            offered_by/2                % ?Word, +Class
          ]).
:- use_module(library(lists)).
:- use_module(facts).
:- use_module(taxonomy, [subclass/2]).
:- use_module(affordances, [affords/4, affords_class/2]).

/** <module> States that robots change: open, switched on, held

Nobody measures them: a robot, or whoever knows, tells them, as an attribute
(`set(object_4, state, open)`) or as a fact (`fact(open(object_4))`,
`fact(holding(agent_rob, object_7))`). What was never told is unknown.
*/

%!  open(?Id) is nondet.
%!  closed(?Id) is nondet.
%!  switched_on(?Id) is nondet.
%!  switched_off(?Id) is nondet.
%!  holding(?Id) is nondet.
%!  holding(?Robot, ?Id) is nondet.
%!  poured(?From, ?Into) is nondet.

open(Id) :- state(Id, open).

closed(Id) :- state(Id, closed).

switched_on(Id) :- state(Id, switched_on).

switched_off(Id) :- state(Id, switched_off).

holding(Id) :- holding(_, Id).

holding(Robot, Id) :- told(holding(Robot, Id)).

poured(From, Into) :- told(poured(From, Into)).

%   state(?Id, +State): told as a fact; or, where no fact says which, as an attribute.
state(Id, State) :-
    Fact =.. [State, Id],
    told(Fact).
state(Id, State) :-
    attribute_says(State, Key, Value),
    attribute(Id, Key, Value),
    \+ told_otherwise(Id, State).

told_otherwise(Id, State) :-
    ( State = One ; opposite(State, One) ),
    Fact =.. [One, Id],
    told(Fact).

opposite(open, closed).                 opposite(closed, open).
opposite(switched_on, switched_off).    opposite(switched_off, switched_on).

attribute_says(open, state, open).              attribute_says(open, open, true).
attribute_says(closed, state, closed).          attribute_says(closed, open, false).
attribute_says(switched_on, state, on).         attribute_says(switched_on, switched_on, true).
attribute_says(switched_off, state, off).       attribute_says(switched_off, switched_on, false).

%!  possible_state(+Goal) is nondet.
%
%   Goal, one of the above, is not known to be false: it was told, or the thing
%   is of a kind that has such states and nobody told which.

possible_state(Goal) :-
    call(Goal).
possible_state(Goal) :-
    Goal =.. [State, Id],
    opposite(State, Other),
    has_states(State, Affordance),
    affording(Id, Affordance),
    \+ state(Id, State),
    \+ state(Id, Other).

has_states(open, openable).             has_states(closed, openable).
has_states(switched_on, powered).       has_states(switched_off, powered).

affording(Id, Affordance) :-
    affords(Affordance, Id, true, _).

%!  offered_by(?Word, +Class) is nondet.
%
%   What robots can do with all things of Class: an affordance of classes, or
%
%     * vessel: something can be poured into it
%     * shut: it has a door or drawer, which is shut as long as nobody told or
%       saw otherwise
%     * classified: the taxonomy says what kind of thing it is

offered_by(Word, Class) :-
    setof(W, Super^( subclass(Class, Super), offers(W, Super) ), Words),
    member(Word, Words).
offered_by(classified, Class) :-
    once(( subclass(Class, Super), Super \== Class )).

offers(Word, Super) :- affords_class(Word, Super).
offers(vessel, Super) :- vessel(Super).
offers(shut, Super) :- shut(Super).

vessel(cup).        vessel(glass).      vessel(bowl).       vessel(jug).
vessel(pot).        vessel(pan).        vessel(kettle).     vessel(vase).
vessel(bucket).     vessel(sink).       vessel(bathtub).    vessel(plant).
vessel(flowerpot).  vessel(bottle).

shut(cabinet).      shut(wardrobe).     shut(drawer).       shut(chest_of_drawers).
shut(dresser).      shut(oven).         shut(fridge).       shut(freezer).
shut(dishwasher).   shut(microwave).    shut(washing_machine).
shut(dryer).        shut(suitcase).     shut(door).         shut(window).
