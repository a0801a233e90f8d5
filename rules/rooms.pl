:- module(rooms,
          [ room_type/2,                % ?Room, ?Type
            room_type/3,                % ?Room, ?Type, -Reason
            type_of_room/1,             % ?Type
            excluded/4                  % ?Room, ?Type, -Truth, -Reason
          ]).
:- use_module(library(lists)).
:- use_module(library(aggregate)).
:- use_module(facts).
:- use_module(taxonomy).
:- use_module(spatial).

/** <module> What a room is, told by what is in it

Each class of things in a room speaks for a type of room with a weight, once
whatever their number. The type with the largest sum wins if the sum reaches
enough_evidence/1. An operator's word, attribute(Room, type, Type), beats all, and
what lies under the open sky is outdoors, whatever stands there.
*/

%!  enough_evidence(-Weight) is det.
%
%   One telling thing (an oven, a bed, a toilet) is enough; a chair is not.

enough_evidence(1.0).

%!  speaks_for(?Class, ?Type, ?Weight) is nondet.
%
%   A thing of Class in a room speaks for Type with Weight; negative: against.

speaks_for(oven,            kitchen,     1.5).
speaks_for(stove,           kitchen,     1.5).
speaks_for(fridge,          kitchen,     1.5).
speaks_for(dishwasher,      kitchen,     1.5).
speaks_for(microwave,       kitchen,     1.0).
speaks_for(extractor_hood,  kitchen,     1.0).
speaks_for(toaster,         kitchen,     0.8).
speaks_for(kettle,          kitchen,     0.8).
speaks_for(cookware,        kitchen,     0.5).
speaks_for(counter,         kitchen,     0.5).
speaks_for(sink,            kitchen,     0.4).
speaks_for(tableware,       kitchen,     0.2).
speaks_for(sofa,            living_room, 1.2).
speaks_for(coffee_table,    living_room, 1.0).
speaks_for(armchair,        living_room, 0.8).
speaks_for(tv,              living_room, 0.7).
speaks_for(bookcase,        living_room, 0.3).
speaks_for(bed,             bedroom,     2.0).
speaks_for(nightstand,      bedroom,     0.8).
speaks_for(wardrobe,        bedroom,     0.7).
speaks_for(pillow,          bedroom,     0.2).
speaks_for(bed,             child_room,  1.6).      % toys make a child's of a bedroom, but none of a hallway
speaks_for(teddy_bear,      child_room,  0.5).
speaks_for(toy_block,       child_room,  0.3).
speaks_for(ball,            child_room,  0.2).
speaks_for(nightstand,      child_room, -0.5).
speaks_for(toilet,          bathroom,    2.0).
speaks_for(bathtub,         bathroom,    2.0).
speaks_for(shower,          bathroom,    2.0).
speaks_for(washing_machine, bathroom,    0.5).
speaks_for(towel,           bathroom,    0.5).
speaks_for(sink,            bathroom,    0.4).
speaks_for(mirror,          bathroom,    0.3).
speaks_for(desk,            office,      1.2).
speaks_for(office_chair,    office,      0.8).
speaks_for(monitor,         office,      0.8).
speaks_for(keyboard,        office,      0.5).
speaks_for(printer,         office,      0.8).
speaks_for(computer,        office,      0.5).
speaks_for(laptop,          office,      0.3).
speaks_for(bed,             office,     -1.0).
speaks_for(dining_table,    dining_room, 1.2).
speaks_for(dining_chair,    dining_room, 0.5).
speaks_for(oven,            dining_room,-1.0).
speaks_for(coat_rack,       hallway,     1.0).
speaks_for(shoe_rack,       hallway,     1.0).
speaks_for(umbrella,        hallway,     0.4).
speaks_for(shoe,            hallway,     0.4).
speaks_for(washing_machine, laundry,     0.9).
speaks_for(dryer,           laundry,     0.9).
speaks_for(laundry_basket,  laundry,     0.5).
speaks_for(toilet,          laundry,    -2.0).
speaks_for(bathtub,         laundry,    -2.0).
speaks_for(shower,          laundry,    -2.0).

%!  hallway_doors(-Number) is det.
%
%   A room that this many doors lead out of, and in which nothing tells another
%   type, is there to be walked through.

hallway_doors(3).

%!  type_of_room(?Type) is nondet.
%
%   Type is a type that a room can be found to have.

type_of_room(Type) :-
    setof(T, C^W^speaks_for(C, T, W), Types),
    member(Type, Types).
type_of_room(outdoors).
type_of_room(Type) :-
    attribute(Room, type, Type),
    Type \== outdoors,
    node(Room, room),
    \+ speaks_for(_, Type, _).

%!  room_type(?Room, ?Type) is nondet.
%
%   Room is a Type. At most one Type a room.

room_type(Room, Type) :-
    room_type(Room, Type, _).

%!  room_type(?Room, ?Type, -Reason) is nondet.
%
%   As room_type/2; Reason is told, or open_sky, or evidence(Sum, [speaks(Class, Weight), ...])
%   with the weightiest class first, or doors(Number).

room_type(Room, Type, Reason) :-
    node(Room, room),
    type_with_reason(Room, Its, Why),
    Type = Its,
    Reason = Why.

:- dynamic remembered/3.                % Room, Revision, Type-Reason or none

%   A room's type is worked out once a revision of the facts.
type_with_reason(Room, Type, Reason) :-
    revision(Now),
    (   remembered(Room, Now, Known)
    ->  Known = Type-Reason
    ;   retractall(remembered(Room, _, _)),
        ( find_type(Room, T, R) -> Found = T-R ; Found = none ),
        assertz(remembered(Room, Now, Found)),
        Found = Type-Reason
    ).

find_type(Room, Type, told) :-
    attribute(Room, type, Type),
    !.
find_type(Room, outdoors, open_sky) :-
    attribute(Room, outdoors, true),
    !.
find_type(Room, Type, evidence(Sum, Because)) :-
    classes_in(Room, Classes),
    findall(T-evidence(S, B), score(Classes, T, S, B), Scores),
    Scores \== [],
    best(Scores, Type, Sum, Because),
    enough_evidence(Enough),
    Sum >= Enough,
    !.
find_type(Room, hallway, doors(Number)) :-
    findall(Door, edge(connects, Door, Room, _, _, _), Doors0),
    sort(Doors0, Doors),
    length(Doors, Number),
    hallway_doors(Enough),
    Number >= Enough.

classes_in(Room, Classes) :-
    findall(Class, ( holds(in, Thing, Room), label(Thing, Class) ), All),
    sort(All, Classes).

%   Every type that some class speaks for, with its sum; several kinds of one speaker count once.
score(Classes, Type, Sum, Because) :-
    setof(T, Classes^spoken_for(Classes, T), Types),
    member(Type, Types),
    findall(Weight-Speaker,
            ( speaks_for(Speaker, Type, Weight),
              once(( member(Class, Classes), subclass(Class, Speaker) )) ),
            Weights),
    sort(1, @>=, Weights, Sorted),
    findall(W, member(W-_, Sorted), Ws),
    sum_list(Ws, Sum),
    findall(speaks(S, W), member(W-S, Sorted), Because).

spoken_for(Classes, Type) :-
    member(Class, Classes),
    subclass(Class, Speaker),
    speaks_for(Speaker, Type, Weight),
    Weight > 0.

best(Scores, Type, Sum, Because) :-
    findall(key(Negative, T)-evidence(S, B),
            ( member(T-evidence(S, B), Scores), Negative is -S ),
            Keyed),
    keysort(Keyed, [key(_, Type)-evidence(Sum, Because)|_]).

%!  indispensable(?Type, ?Classes) is nondet.
%
%   In every room of Type there is a thing of one of Classes.

indispensable(kitchen,     [sink]).
indispensable(kitchen,     [oven, stove, microwave]).
indispensable(bathroom,    [toilet, bathtub, shower]).
indispensable(bedroom,     [bed, sofa]).
indispensable(child_room,  [bed]).
indispensable(living_room, [seat]).
indispensable(dining_room, [table]).
indispensable(office,      [desk, table]).
indispensable(laundry,     [washing_machine, dryer]).

%!  excluded(?Room, ?Type, -Truth, -Reason) is nondet.
%
%   Whether Room cannot be a Type: it was told to be another, or lies under the
%   open sky; or it lacks what is indispensable. Truth is unknown where part of
%   the room was not seen, unobserved(Room), for what is missing may be there.
%   Reason is told(Other), open_sky, or without(Classes).

excluded(Room, Type, Truth, Reason) :-
    node(Room, room),
    ( nonvar(Type) -> true ; setof(T, Cs^indispensable(T, Cs), Types), member(Type, Types) ),
    (   attribute(Room, type, Other)
    ->  ( Other == Type -> Truth0 = false ; Truth0 = true ),
        Reason0 = told(Other)
    ;   attribute(Room, outdoors, true)
    ->  ( Type == outdoors -> Truth0 = false ; Truth0 = true ),
        Reason0 = open_sky
    ;   indispensable(Type, Classes),
        \+ has_one_of(Room, Classes, true)
    ->  ( ( unobserved(Room) ; has_one_of(Room, Classes, unknown) ) -> Truth0 = unknown ; Truth0 = true ),
        Reason0 = without(Classes)
    ;   Truth0 = false,
        Reason0 = nothing_missing
    ),
    Truth = Truth0,
    Reason = Reason0.

%   has_one_of(+Room, +Classes, ?Truth): a thing of one of Classes is in Room, or may be.
has_one_of(Room, Classes, Truth) :-
    member(Class, Classes),
    labelled(Thing, Class),
    (   holds(in, Thing, Room)
    ->  Its = true
    ;   possibly_holds(in, Thing, Room),
        Its = unknown
    ),
    Truth = Its,
    !.
