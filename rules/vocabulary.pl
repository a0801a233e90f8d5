:- module(vocabulary,
          [ signature/2,                % ?Head, -Documentation
            possibly/1,                 % :Goal
            possible_instance/2,        % ?Id, +Class
            unseen/1,                   % +Goal
            known_class/1,              % ?Class
            node/2, label/2, named/2, position/4, size/4, yaw/2, confidence/2, seen/3, attribute/3,
            measured/3, measured/4, unobserved/1,
            instance_of/2, subclass/2, room_type/2, cannot_be/2, fact/1,
            object/1, room/1, structure/1, agent/1, place/1,
            on/2, supports/2, in/2, contains/2, above/2, under/2, near/2, touching/2, next_to/2,
            in_front_of/2, behind/2, left_of/2, right_of/2,
            in_front_of/3, behind/3, left_of/3, right_of/3,
            connects/2, adjacent/2, leads_to/2, part_of/2, attached_to/2, hanging_from/2,
            visible_from/2, reachable/2, blocks/2,
            holds/2, held/3, last_seen/2, changed_since/2, allen/3,
            before/2, after/2, meets/2, met_by/2, overlaps/2, overlapped_by/2, starts/2, started_by/2,
            during/2, encloses/2, finishes/2, finished_by/2, equals/2,
            distance/3, gap/3, larger/2,
            color/2, size/2, volume/2, height/2, width/2, depth/2, area/2,
            nearest/3, farthest/3, largest/2, smallest/2, tallest/2, latest/2,
            graspable/1, openable/1, container/1, surface/1, sittable/1, powered/1, pourable/1, movable/1,
            can_reach/1, can_carry/1, fits_through/1, asker/1,
            place_setting/3, workplace/3,
            open/1, closed/1, switched_on/1, switched_off/1, holding/1, holding/2, poured/2
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(facts).
:- use_module(taxonomy).
:- use_module(spatial).
:- use_module(rooms).
:- use_module(viewpoint).
:- use_module(ways).
:- use_module(history).
:- use_module(names, [name_atom/2]).
:- use_module(properties).
:- use_module(affordances).
:- use_module(groups).
:- use_module(states).

/** <module> The words in which questions are asked

What stands in signature/2, and nothing else but plain logic and arithmetic, can
be asked. An argument marked `thing` takes an id, or a class or room type or name
that stands for any instance of it; `class`, `key`, `layer`, `relation`,
`measurement` and `value` take a name; `number` a number; `text` a string; `any`
whatever there is. Any argument may be a variable.
*/

:- discontiguous signature/2.

%!  signature(?Head, -Documentation:string) is nondet.
%
%   Head is askable; its arguments are the kinds of its arguments.

                /*******************************
                *        WHAT THERE IS         *
                *******************************/

signature(node(thing, layer),
          "the thing is in this layer of the graph: building, storey, room, place, object, structure, agent").
signature(label(thing, class), "the thing's own label, without the taxonomy").
signature(named(thing, text), "the name that the thing goes by").
signature(position(thing, number, number, number), "centre x, y, z in the map frame, metres").
signature(size(thing, number, number, number), "extent of the oriented box, metres").
signature(yaw(thing, number), "rotation about z, radians").
signature(confidence(thing, number), "how sure it is that the thing is what its label says, 0 to 1").
signature(seen(thing, number, number), "first and last sight, nanoseconds").
signature(attribute(thing, key, value), "an attribute of the thing, such as its colour").
signature(measured(measurement, thing, any), "a measurement of one thing, SI units").
signature(measured(measurement, thing, thing, any), "a measurement of two things, SI units").
signature(unobserved(any), "part of this region has not been seen").

signature(instance_of(thing, class), "the thing is of this class, or of a class below it").

%!  instance_of(?Id, ?Class) is nondet.
%
%   Id carries Class or a class below it as its label; or Class is its layer, or
%   the type of the room Id, or a name that Id goes by.

instance_of(Id, Class) :-
    nonvar(Id),
    !,
    (   labelled(Id, Class)
    ;   node(Id, Class), layer_class(Class)
    ;   room_type(Id, Class)
    ;   goes_by(Id, Class)
    ).
instance_of(Id, Class) :-
    nonvar(Class),
    !,
    (   layer_class(Class)
    ->  node(Id, Class)
    ;   labelled(Id, Class)
    ;   type_of_room(Class), room_type(Id, Class)
    ;   goes_by(Id, Class)
    ).
instance_of(Id, Class) :-
    labelled(Id, Class).
instance_of(Id, Type) :-
    room_type(Id, Type).

layer_class(object).
layer_class(room).
layer_class(place).
layer_class(agent).
layer_class(structure).
layer_class(building).
layer_class(storey).

goes_by(Id, Atom) :-
    nonvar(Atom),
    named(Id, Name),
    name_atom(Name, Atom).

signature(subclass(class, class), "the first class is the second or below it").
signature(room_type(thing, class), "the room's type, told by what is in it").
signature(cannot_be(thing, class), "the room lacks what every room of this type has").

%!  cannot_be(?Room, ?Type) is nondet.

cannot_be(Room, Type) :-
    excluded(Room, Type, true, _).
signature(fact(any), "what an operator told").

%!  fact(?Term) is nondet.

fact(Term) :-
    told(Term).

signature(object(thing), "a movable or free-standing thing").
signature(room(thing), "a room").
signature(structure(thing), "a wall, floor, ceiling, door or other part of the building").
signature(agent(thing), "a robot or a person").
signature(place(thing), "a place where a robot can stand").

object(Id) :- node(Id, object).
room(Id) :- node(Id, room).
structure(Id) :- node(Id, structure).
agent(Id) :- node(Id, agent).
place(Id) :- node(Id, place).

                /*******************************
                *          RELATIONS           *
                *******************************/

signature(on(thing, thing), "the first rests on the second").
signature(supports(thing, thing), "the second rests on the first").
signature(in(thing, thing), "the first is inside the second, a container or a room").
signature(contains(thing, thing), "the second is inside the first").
signature(above(thing, thing), "the first is over the second without resting on it").
signature(under(thing, thing), "the first is below the second without carrying it").
signature(near(thing, thing), "a short way apart, around walls").
signature(touching(thing, thing), "their surfaces meet").
signature(next_to(thing, thing), "near, on the same support, with nothing between").

on(A, B) :- holds(on, A, B).
supports(A, B) :- holds(supports, A, B).
in(A, B) :- within(A, B).
contains(A, B) :- within(B, A).
above(A, B) :- holds(above, A, B).
under(A, B) :- holds(under, A, B).
near(A, B) :- holds(near, A, B).
near(A, B) :- near_agent(A, B, true).
touching(A, B) :- holds(touching, A, B).
next_to(A, B) :- holds(next_to, A, B).

%   near_agent(?A, ?B, -Truth): one is a robot or person, which moves too often to be measured like things: by its place,
%   true in the same room, and unknown through what may be a wall.
near_agent(A, B, Truth) :-
    (   nonvar(B), node(B, agent)
    ->  Agent = B, Thing = A
    ;   nonvar(A), node(A, agent),
        Agent = A, Thing = B
    ),
    position(Agent, XA, YA, _),
    node(Thing, object),
    position(Thing, X, Y, _),
    near_distance(Thing, Agent, Near),
    ( size(Thing, SX, SY, _) -> Half is max(SX, SY)/2 ; Half = 0 ),
    sqrt((X-XA)**2+(Y-YA)**2)-Half =< Near,
    (   holds(in, Thing, Room),
        node(Room, room),
        holds(in, Agent, Room)
    ->  Truth = true
    ;   Truth = unknown
    ).

%   within(?A, ?B): A is in B, or in a room of the storey or building B, or in a storey of the building B.
%   Whoever asks what is in a room does not mean the places in it: of these it is only told where they are.
within(A, B) :-
    var(A),
    !,
    ( holds(in, A, B) ; within_part(A, B) ),
    \+ node(A, place).
within(A, B) :-
    ( holds(in, A, B) ; within_part(A, B) ).

within_part(A, B) :-
    (   nonvar(B)
    ->  whole(B),
        edge(in, Part, B, _, _, _),
        within(A, Part)
    ;   holds(in, A, Part),
        whole_around(Part, B)
    ).

whole(B) :- node(B, storey).
whole(B) :- node(B, building).

whole_around(Part, Whole) :-
    ( node(Part, room) ; node(Part, storey) ),
    edge(in, Part, Next, _, _, _),
    whole(Next),
    ( Whole = Next ; whole_around(Next, Whole) ).

signature(in_front_of(thing, thing), "before the second, for the viewer; without one, at its own front").
signature(behind(thing, thing), "behind the second, for the viewer").
signature(left_of(thing, thing), "left of the second, for the viewer").
signature(right_of(thing, thing), "right of the second, for the viewer").
signature(in_front_of(thing, thing, thing), "before the second, for the third").
signature(behind(thing, thing, thing), "behind the second, for the third").
signature(left_of(thing, thing, thing), "left of the second, for the third").
signature(right_of(thing, thing, thing), "right of the second, for the third").

in_front_of(A, B) :- viewer(V), seen_from(in_front_of, A, B, V, _).
behind(A, B) :- viewer(V), seen_from(behind, A, B, V, _).
left_of(A, B) :- viewer(V), seen_from(left_of, A, B, V, _).
right_of(A, B) :- viewer(V), seen_from(right_of, A, B, V, _).

in_front_of(A, B, V) :- somebody(V), seen_from(in_front_of, A, B, V, _).
behind(A, B, V) :- somebody(V), seen_from(behind, A, B, V, _).
left_of(A, B, V) :- somebody(V), seen_from(left_of, A, B, V, _).
right_of(A, B, V) :- somebody(V), seen_from(right_of, A, B, V, _).

somebody(V) :- nonvar(V), !.
somebody(V) :- node(V, agent).

signature(between(thing, thing, thing), "the first lies between the second and the third").

%   Not exported: between/3 of whole numbers stays what it is elsewhere.
between(A, B, C) :- lies_between(A, B, C, _).

signature(connects(thing, thing), "the door or opening leads into the room").
signature(adjacent(thing, thing), "the rooms share a door or opening").
signature(leads_to(thing, thing), "the robot gets from the first room to the second, through doors that it can open").
signature(part_of(thing, thing), "the first is a part of the second").
signature(attached_to(thing, thing), "the first is fixed to the side of the second").
signature(hanging_from(thing, thing), "the first hangs from the second").
signature(visible_from(thing, thing), "a line of sight leads from the second, a robot or a place, to the first").
signature(reachable(thing, thing), "the second, a robot, finds a way to where it can reach the first").
signature(blocks(thing, thing), "the first stands in the door or opening so that the robot cannot pass").

connects(A, B) :- edge(connects, A, B, _, _, _).
part_of(A, B) :- holds(part_of, A, B).
attached_to(A, B) :- holds(attached_to, A, B).
hanging_from(A, B) :- holds(hanging_from, A, B).
visible_from(A, P) :- holds(visible_from, A, P).
reachable(A, Robot) :- holds(reachable, A, Robot).
blocks(A, Door) :- holds(blocks, A, Door).

                /*******************************
                *          PROPERTIES          *
                *******************************/

signature(color(thing, value), "the thing's colour, mainly").
signature(size(thing, number), "longest edge of the box, metres").
signature(volume(thing, number), "volume of the box, cubic metres").
signature(height(thing, number), "vertical extent, metres").
signature(width(thing, number), "longer horizontal edge of the box, metres").
signature(depth(thing, number), "shorter horizontal edge of the box, metres").
signature(area(thing, number), "ground that the thing or room covers, square metres").

color(A, Color) :- property(color, A, Color).
size(A, Metres) :- property(size, A, Metres).
volume(A, Volume) :- property(volume, A, Volume).
height(A, Metres) :- property(height, A, Metres).
width(A, Metres) :- property(width, A, Metres).
depth(A, Metres) :- property(depth, A, Metres).
area(A, Area) :- property(area, A, Area).

signature(distance(thing, thing, number), "metres between the centres").
signature(gap(thing, thing, number), "metres between the surfaces").
signature(larger(thing, thing), "the first box has the larger volume").

gap(A, B, Gap) :-
    mutual(gap, A, B, Gap),
    number(Gap).

%!  larger(?A, ?B) is nondet.

larger(A, B) :-
    size(A, XA, YA, ZA),
    size(B, XB, YB, ZB),
    XA*YA*ZA > XB*YB*ZB.

                /*******************************
                *         SUPERLATIVES         *
                *******************************/

signature(nearest(thing, class, thing), "of all of the class, the first is the nearest to the third, by their centres").
signature(farthest(thing, class, thing), "of all of the class, the first is the farthest from the third").
signature(largest(thing, class), "of all of the class it has the largest volume; of rooms, the largest area").
signature(smallest(thing, class), "of all of the class it has the smallest volume; of rooms, the smallest area").
signature(tallest(thing, class), "of all of the class it has the largest vertical extent").
signature(latest(thing, class), "of all of the class it was seen most recently").

nearest(A, Class, B) :- foremost(least, distance_to(B), A, Class).
farthest(A, Class, B) :- foremost(most, distance_to(B), A, Class).
largest(A, Class) :- foremost(most, extent, A, Class).
smallest(A, Class) :- foremost(least, extent, A, Class).
tallest(A, Class) :- foremost(most, height, A, Class).
latest(A, Class) :- foremost(most, last_seen, A, Class).

%   foremost(+How, +Measure, ?Thing, ?Class): Thing has the most or the least of what Measure says, of all of Class.
foremost(How, distance_to(B), Thing, Class) :-
    var(B),
    !,
    node(B, object),
    foremost(How, distance_to(B), Thing, Class).
foremost(How, Measure, Thing, Class) :-
    ( nonvar(Class) -> true ; setof(C, Id^label(Id, C), Classes), member(Class, Classes) ),
    findall(Value-Id,
            ( instance_of(Id, Class),
              once(measure(Measure, Id, Value)) ),
            Pairs0),
    sort(Pairs0, Pairs),
    Pairs = [Least-_|_],
    (   How == least
    ->  Best = Least
    ;   last(Pairs, Best-_)
    ),
    member(Best-Thing, Pairs).

measure(distance_to(B), Id, Value) :- distance(Id, B, Value).
measure(extent, Id, Value) :- ( node(Id, room) -> property(area, Id, Value) ; property(volume, Id, Value) ).
measure(height, Id, Value) :- property(height, Id, Value).
measure(last_seen, Id, Value) :- seen(Id, _, Value).

                /*******************************
                *  AFFORDANCES, CAPABILITIES   *
                *******************************/

signature(graspable(thing), "a hand closes around it: small enough, and no fixture").
signature(openable(thing), "it can be opened and closed").
signature(container(thing), "it holds others inside").
signature(surface(thing), "others can be put down on it").
signature(sittable(thing), "a person can sit on it").
signature(powered(thing), "it runs on electricity").
signature(pourable(thing), "something can be poured out of it").
signature(movable(thing), "it is no fixture: it can be carried or shoved elsewhere").
signature(can_reach(thing), "the robot that asks finds a way to where it can reach it").
signature(can_carry(thing), "the robot that asks can carry it: no fixture, and light enough").
signature(fits_through(thing), "the robot that asks fits through this door or opening").
signature(asker(thing), "the robot that asks").

graspable(A) :- affords(graspable, A, true, _).
openable(A) :- affords(openable, A, true, _).
container(A) :- affords(container, A, true, _).
surface(A) :- affords(surface, A, true, _).
sittable(A) :- affords(sittable, A, true, _).
powered(A) :- affords(powered, A, true, _).
pourable(A) :- affords(pourable, A, true, _).
movable(A) :- affords(movable, A, true, _).
can_reach(A) :- can(can_reach, A, true, _).
can_carry(A) :- can(can_carry, A, true, _).
fits_through(A) :- can(fits_through, A, true, _).
asker(Robot) :- asking(Robot).

                /*******************************
                *            GROUPS            *
                *******************************/

signature(place_setting(thing, thing, thing), "a plate, a fork and a knife that are near each other on one support").
signature(workplace(thing, thing, thing), "a desk or table, a seat near it, and a screen or keyboard on it").

place_setting(Plate, Fork, Knife) :- group(place_setting(Plate, Fork, Knife), true).
workplace(Desk, Seat, Screen) :- group(workplace(Desk, Seat, Screen), true).

                /*******************************
                *            STATES            *
                *******************************/

signature(open(thing), "its door, lid or drawer is open").
signature(closed(thing), "its door, lid or drawer is shut").
signature(switched_on(thing), "it is switched on").
signature(switched_off(thing), "it is switched off").
signature(holding(thing), "a robot holds it").
signature(holding(thing, thing), "the first, a robot, holds the second").
signature(poured(thing, thing), "what was in the first was poured into the second").

%!  state_word(+Goal) is semidet.
%
%   Goal is one of these, of which it may not be known which holds.

state_word(open(_)).
state_word(closed(_)).
state_word(switched_on(_)).
state_word(switched_off(_)).

                /*******************************
                *             TIME             *
                *******************************/

signature(holds(state, moment), "the fact held at that moment: nanoseconds, now, ago(Seconds), an event, a told moment").
signature(held(state, any, any), "from when to when the fact held, nanoseconds; until `now` when it still does").
signature(last_seen(once, number), "when the thing, which may have gone, was seen last, nanoseconds").
signature(changed_since(moment, event),
          "what happened since: appeared, moved, vanished, merged, split, relabelled, began(Fact), ended(Fact)").
signature(allen(any, occurrence, occurrence), "Allen's relation of two intervals: of facts, sightings, events, moments").
signature(before(occurrence, occurrence), "an interval of the first ends before the second begins").
signature(after(occurrence, occurrence), "an interval of the first begins after the second has ended").
signature(meets(occurrence, occurrence), "an interval of the first ends when the second begins").
signature(met_by(occurrence, occurrence), "an interval of the first begins when the second ends").
signature(overlaps(occurrence, occurrence), "an interval of the first begins first and ends within the second").
signature(overlapped_by(occurrence, occurrence), "an interval of the first begins within the second and ends last").
signature(starts(occurrence, occurrence), "an interval of the first begins with the second and ends before it").
signature(started_by(occurrence, occurrence), "an interval of the first begins with the second and ends after it").
signature(during(occurrence, occurrence), "an interval of the first begins after the second and ends before it").
signature(encloses(occurrence, occurrence), "an interval of the first begins before the second and ends after it").
signature(finishes(occurrence, occurrence), "an interval of the first begins after the second and ends with it").
signature(finished_by(occurrence, occurrence), "an interval of the first begins before the second and ends with it").
signature(equals(occurrence, occurrence), "an interval of the first begins and ends with the second").

                /*******************************
                *       WHAT MAY BE TRUE       *
                *******************************/

%!  known_class(?Class) is nondet.
%
%   Class can be asked about: a class of things, a layer or a type of room.

known_class(Class) :-
    (   class(Class)
    ;   layer_class(Class)
    ;   type_of_room(Class)
    ).

%!  possible_instance(?Id, +Class) is nondet.
%
%   Id is a Class, or stands for one that was not seen yet: '$some'(Class), when
%   no instance is known and part of the world is unobserved.

possible_instance(Id, Class) :-
    instance_of(Id, Class).
possible_instance(Id, Class) :-
    nonvar(Class),
    unobserved(world),
    \+ instance_of(_, Class),
    Id = '$some'(Class).

%!  possibly(:Goal) is nondet.
%
%   Goal, one of signature/2, is not known to be false: it holds, or a
%   measurement that would decide it is unknown, or it is about something that
%   was not seen yet.

possibly(Goal) :-
    unseen(Goal),
    !.
possibly(Goal) :-
    past_word(Goal),
    !,
    possibly_past(Goal).
possibly(instance_of(Id, Class)) :-
    !,
    possible_instance(Id, Class).
possibly(room_type(Id, Class)) :-
    !,
    (   room_type(Id, Class)
    ;   unobserved(world),
        node(Id, room),
        \+ room_type(Id, _)
    ).
possibly(cannot_be(Room, Type)) :-
    !,
    excluded(Room, Type, Truth, _),
    Truth \== false.
possibly(Goal) :-
    superlative(Goal, Class),
    (   nonvar(Class),
        \+ instance_of(_, Class)
    ->  !,
        unobserved(world)
    ;   !,
        call(Goal)
    ).
possibly(Goal) :-
    state_word(Goal),
    !,
    possible_state(Goal).
possibly(leads_to(A, B)) :-
    !,
    possibly_leads_to(A, B).
possibly(gap(A, B, Gap)) :-
    !,
    mutual(gap, A, B, Value),
    ( Value == unknown -> true ; Gap = Value ).
possibly(near(A, B)) :-
    near_agent(A, B, _).
possibly(in(A, B)) :-
    !,
    possibly_within(A, B).
possibly(contains(A, B)) :-
    !,
    possibly_within(B, A).
possibly(Goal) :-
    Goal =.. [Relation, A, B],
    graded(Relation),
    !,
    possibly_holds(Relation, A, B).
possibly(Goal) :-
    Goal =.. [Word, A],
    (   affordance(Word)
    ->  !,
        affords(Word, A, Truth, _)
    ;   capability(Word),
        !,
        can(Word, A, Truth, _)
    ),
    Truth \== false.
possibly(Goal) :-
    Goal =.. [Property, A, Value],
    property_name(Property),
    !,
    (   property(Property, A, Value)
    ;   lacking(Property, A)
    ).
possibly(Goal) :-
    grouped(Goal),
    !,
    (   group(Goal, Truth),
        Truth \== false
    ;   unobserved(world),
        once(never_seen(Goal, _))
    ).
possibly(Goal) :-
    own_frame(Goal, B),
    viewer(Viewer),
    \+ Viewer = point(_, _, _),
    !,
    (   call(Goal)
    ;   Viewer \== none
    ->  \+ position(Viewer, _, _, _)
    ;   ( var(B) -> true ; \+ attribute(B, front, _) )
    ).
possibly(Goal) :-
    call(Goal).

possibly_within(A, B) :-
    ( var(A) -> Listed = true ; Listed = false ),
    ( possibly_holds(in, A, B) ; within_part(A, B) ),
    ( Listed == true -> \+ node(A, place) ; true ).

graded(Relation) :-
    (   symmetric(Relation)
    ;   one_way(Relation)
    ;   on_demand(Relation)
    ;   inverse(Relation, _)
    ;   inverse(_, Relation)
    ),
    !.

%!  unseen(+Goal) is semidet.
%
%   An argument of Goal stands for something that was not seen yet.

unseen(Goal) :-
    arg(_, Goal, Argument),
    nonvar(Argument),
    Argument = '$some'(_),
    !.

superlative(nearest(_, Class, _), Class).
superlative(farthest(_, Class, _), Class).
superlative(largest(_, Class), Class).
superlative(smallest(_, Class), Class).
superlative(tallest(_, Class), Class).
superlative(latest(_, Class), Class).

own_frame(in_front_of(_, B), B).
own_frame(behind(_, B), B).
own_frame(left_of(_, B), B).
own_frame(right_of(_, B), B).
