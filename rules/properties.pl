:- module(properties,
          [ property/3,                 % +Property, ?Thing, ?Value
            property_name/1,            % ?Property
            lacking/2                   % +Property, ?Thing
          ]).
:- use_module(facts).

/** <module> Colours and dimensions

What is read off a thing's box and attributes. Lengths in metres, areas and
volumes in square and cubic metres. What was never measured is unknown, not
false: lacking/2 names the things without a value.

    ?- property(height, table_1, H).
    H = 0.75.
*/

%!  property_name(?Property) is nondet.

property_name(color).
property_name(size).
property_name(volume).
property_name(height).
property_name(width).
property_name(depth).
property_name(area).

%!  property(+Property, ?Thing, ?Value) is nondet.
%
%   Thing's Property is Value. The area of a room is that of its footprint; a
%   colour that somebody told beats the one that was seen.

property(color, Thing, Color) :-
    nonvar(Thing),
    !,
    (   ( attribute(Thing, color, Told) ; attribute(Thing, colour, Told) )
    *-> Color = Told
    ;   attribute(Thing, seen_color, Color)
    ).
property(color, Thing, Color) :-
    attribute(Thing, color, Color).
property(color, Thing, Color) :-
    attribute(Thing, colour, Color).
property(color, Thing, Color) :-
    attribute(Thing, seen_color, Color),
    \+ attribute(Thing, color, _),
    \+ attribute(Thing, colour, _).
property(size, Thing, Size) :-
    size(Thing, X, Y, Z),
    Size is max(X, max(Y, Z)).
property(volume, Thing, Volume) :-
    size(Thing, X, Y, Z),
    Volume is X*Y*Z.
property(height, Thing, Height) :-
    size(Thing, _, _, Height).
property(width, Thing, Width) :-
    size(Thing, X, Y, _),
    Width is max(X, Y).
property(depth, Thing, Depth) :-
    size(Thing, X, Y, _),
    Depth is min(X, Y).
property(area, Thing, Area) :-
    nonvar(Thing),
    !,
    (   attribute(Thing, area_m2, Told),
        number(Told)
    ->  Area = Told
    ;   size(Thing, X, Y, _),
        Area is X*Y
    ).
property(area, Thing, Area) :-
    size(Thing, _, _, _),
    property(area, Thing, Area).

%!  lacking(+Property, ?Thing) is nondet.
%
%   The object Thing has no known value of Property; none is known of '$some'(Class) either.

lacking(Property, Thing) :-
    (   nonvar(Thing)
    ->  true
    ;   node(Thing, object)
    ),
    \+ property(Property, Thing, _).
