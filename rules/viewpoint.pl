:- module(viewpoint,
          [ seen_from/5,                % +Relation, ?A, ?B, +Viewer, -Tests
            viewer/1,                   % -Viewer
            set_viewer/1,               % +Viewer
            distance/3,                 % ?A, ?B, -Metres
            between_them/3              % +A, +B, ?Thing
          ]).
:- use_module(library(lists)).
:- use_module(facts).
:- use_module(spatial).

/** <module> Relations that depend on where one stands

Worked out when asked, never stored. For the viewer V and a landmark B the axis
points from B towards V. A is in front of B within 45 degrees of the axis, behind
it within 45 degrees of the opposite; left and right are the viewer's, by V's
position and not its heading. Sectors are half-open, so exactly one relation
holds for everything within reach/1.

Without a viewer B's own frame is used, if its front is known: attribute(B,
front, Yaw) in radians about z; left is then B's own left.
*/

%!  reach(-Metres) is det.
%
%   Beyond this nobody says "left of the lamp".

reach(3.0).

:- dynamic current_viewer/1.
current_viewer(none).

%!  set_viewer(+Viewer) is det.
%
%   Viewer is an id, point(X, Y, Z), or none.

set_viewer(Viewer) :-
    retractall(current_viewer(_)),
    assertz(current_viewer(Viewer)).

%!  viewer(-Viewer) is det.

viewer(Viewer) :-
    current_viewer(Viewer).

%!  seen_from(+Relation, ?A, ?B, +Viewer, -Tests) is nondet.
%
%   A is Relation (in_front_of, behind, left_of, right_of) B for Viewer: an id,
%   point(X, Y, Z), or none for B's own frame. Tests name the frame used.

seen_from(Relation, A, B, Viewer, [ test(bearing, Degrees, within, Frame, Relation),
                                    test(centre_distance, Distance, =<, reach, Reach) ]) :-
    reach(Reach),
    position(B, XB, YB, _),
    axis(Viewer, B, XB, YB, Axis, Frame),
    position(A, XA, YA, _),
    A \== B,
    DX is XA-XB,
    DY is YA-YB,
    Distance is sqrt(DX*DX+DY*DY),
    Distance =< Reach,
    Distance > 0,
    \+ node(A, room),
    \+ node(A, building),
    Bearing is atan2(DY, DX)-Axis,
    sector(Bearing, Frame, Relation, Degrees).

axis(none, B, _, _, Axis, own_frame(B)) :-
    !,
    attribute(B, front, Axis),
    number(Axis).
axis(point(X, Y, _), _, XB, YB, Axis, viewer(point)) :-
    !,
    direction(XB, YB, X, Y, Axis).
axis(Viewer, _, XB, YB, Axis, viewer(Viewer)) :-
    position(Viewer, X, Y, _),
    direction(XB, YB, X, Y, Axis).

direction(X0, Y0, X, Y, Angle) :-
    DX is X-X0,
    DY is Y-Y0,
    ( DX =\= 0 -> true ; DY =\= 0 ),
    Angle is atan2(DY, DX).

%   The viewer looks against the axis, so what is counterclockwise of it is on the viewer's right.
sector(Bearing, Frame, Relation, Degrees) :-
    Raw is Bearing*180/pi,
    Degrees is Raw-360*floor((Raw+45)/360),     % -45 =< Degrees < 315
    quarter(Degrees, Quarter),
    named(Quarter, Frame, Relation).

quarter(Degrees, 0) :- Degrees < 45, !.
quarter(Degrees, 1) :- Degrees < 135, !.
quarter(Degrees, 2) :- Degrees < 225, !.
quarter(_, 3).

named(0, _, in_front_of).
named(1, viewer(_), right_of).
named(1, own_frame(_), left_of).
named(2, _, behind).
named(3, viewer(_), left_of).
named(3, own_frame(_), right_of).

%!  distance(?A, ?B, -Metres) is nondet.
%
%   Metres between the centres of A and B.

distance(A, B, Metres) :-
    position(A, XA, YA, ZA),
    position(B, XB, YB, ZB),
    A \== B,
    Metres is sqrt((XA-XB)**2+(YA-YB)**2+(ZA-ZB)**2).

%!  between_them(+A, +B, ?Thing) is nondet.
%
%   Thing's oriented box is crossed by the segment between the centres of A and
%   B; Thing is neither of them nor what they stand on, and near both.

between_them(A, B, Thing) :-
    position(A, XA, YA, ZA),
    position(B, XB, YB, ZB),
    possibly_holds(near, A, Thing),
    Thing \== B,
    possibly_holds(near, B, Thing),
    position(Thing, X, Y, Z),
    size(Thing, SX, SY, SZ),
    Low is Z-SZ/2,
    High is Z+SZ/2,
    ( ZA >= Low, ZA =< High -> true ; ZB >= Low, ZB =< High ),
    ( yaw(Thing, Yaw) -> true ; Yaw = 0 ),
    Cos is cos(Yaw),
    Sin is sin(Yaw),
    into(XA, YA, X, Y, Cos, Sin, UA, VA),
    into(XB, YB, X, Y, Cos, Sin, UB, VB),
    HX is SX/2,
    HY is SY/2,
    clip(UA, UB, HX, 0, 1, T0, T1),
    clip(VA, VB, HY, T0, T1, _, _).

into(X, Y, X0, Y0, Cos, Sin, U, V) :-
    U is (X-X0)*Cos+(Y-Y0)*Sin,
    V is (Y-Y0)*Cos-(X-X0)*Sin.

%   clip(+From, +To, +Half, +T0, +T1, -S0, -S1): the part of the segment inside the slab -Half .. Half.
clip(From, To, Half, T0, T1, T0, T1) :-
    abs(To-From) < 1.0e-9,
    !,
    abs(From) =< Half.
clip(From, To, Half, T0, T1, S0, S1) :-
    A is (-Half-From)/(To-From),
    B is (Half-From)/(To-From),
    S0 is max(T0, min(A, B)),
    S1 is min(T1, max(A, B)),
    S0 =< S1.
