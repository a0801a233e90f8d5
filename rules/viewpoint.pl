:- module(viewpoint,
          [ seen_from/5,                % +Relation, ?A, ?B, +Viewer, -Tests
            viewer/1,                   % -Viewer
            set_viewer/1,               % +Viewer
            distance/3,                 % ?A, ?B, -Metres
            lies_between/4,             % ?A, ?B, ?C, -Share
            between_share/1             % -Share
          ]).
:- use_module(library(apply)).
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

%!  between_share(-Share) is det.
%
%   What lies between two things has at least half of its footprint there.

between_share(0.5).

%!  lies_between(?A, ?B, ?C, -Share) is nondet.
%
%   Share, at least between_share/1, of A's footprint lies inside the hull of
%   B's and C's and outside both. Footprints are the outlines that were measured,
%   else those of the oriented boxes.

lies_between(A, B, C, Share) :-
    footprint(B, PolygonB),
    footprint(C, PolygonC),
    B \== C,
    append(PolygonB, PolygonC, Corners),
    convex_hull(Corners, Hull),
    bounds(Hull, Bounds),
    between_share(Enough),
    footprint(A, PolygonA),
    A \== B,
    A \== C,
    bounds(PolygonA, BoundsA),
    overlapping(BoundsA, Bounds),
    area(PolygonA, Whole),
    Whole > 0,
    common_area(PolygonA, Hull, Inside),
    Inside >= Enough*Whole,
    clipped(PolygonA, PolygonB, InB),
    area(InB, AreaB),
    common_area(PolygonA, PolygonC, AreaC),
    common_area(InB, PolygonC, AreaBoth),
    Share is (Inside-AreaB-AreaC+AreaBoth)/Whole,
    Share >= Enough.

%   footprint(?Thing, -Corners): as it was measured, else of the oriented box, counterclockwise, as X-Y.
footprint(Thing, Corners) :-
    outline(Thing, Listed),
    findall(X-Y, member([X, Y], Listed), Corners).
footprint(Thing, [A, B, C, D]) :-
    size(Thing, SX, SY, _),
    \+ outline(Thing, _),
    node(Thing, Layer),
    memberchk(Layer, [object, structure, agent]),
    position(Thing, X, Y, _),
    ( yaw(Thing, Yaw) -> true ; Yaw = 0 ),
    UX is cos(Yaw)*SX/2, UY is sin(Yaw)*SX/2,
    VX is -sin(Yaw)*SY/2, VY is cos(Yaw)*SY/2,
    corner(X, Y, UX, UY, VX, VY, -1, -1, A),
    corner(X, Y, UX, UY, VX, VY, 1, -1, B),
    corner(X, Y, UX, UY, VX, VY, 1, 1, C),
    corner(X, Y, UX, UY, VX, VY, -1, 1, D).

corner(X, Y, UX, UY, VX, VY, U, V, CX-CY) :-
    CX is X+U*UX+V*VX,
    CY is Y+U*UY+V*VY.

%   bounds(+Corners, -Bounds): of the upright rectangle about a polygon.
bounds([X-Y|Corners], Bounds) :-
    foldl(widened, Corners, bounds(X, X, Y, Y), Bounds).

widened(X-Y, bounds(X0, X1, Y0, Y1), bounds(X2, X3, Y2, Y3)) :-
    X2 is min(X, X0), X3 is max(X, X1),
    Y2 is min(Y, Y0), Y3 is max(Y, Y1).

overlapping(bounds(A0, A1, B0, B1), bounds(C0, C1, D0, D1)) :-
    A0 < C1, C0 < A1,
    B0 < D1, D0 < B1.

common_area(A, B, Area) :-
    clipped(A, B, Common),
    area(Common, Area).

%   clipped(+Polygon, +Convex, -Common): what of a polygon lies in a convex one, both counterclockwise.
clipped(Polygon, Convex, Common) :-
    Convex = [First|_],
    append(Convex, [First], Closed),
    clip_at_sides(Closed, Polygon, Common).

clip_at_sides([P, Q|Sides], Polygon, Common) :-
    !,
    clip_at(Polygon, P, Q, Left),
    clip_at_sides([Q|Sides], Left, Common).
clip_at_sides(_, Common, Common).

%   clip_at(+Polygon, +P, +Q, -Left): what lies left of the line from P to Q (Sutherland and Hodgman, 1974).
clip_at([], _, _, []).
clip_at(Polygon, P, Q, Left) :-
    Polygon = [First|_],
    append(Polygon, [First], Closed),
    clip_corners(Closed, P, Q, Left).

clip_corners([A, B|Corners], P, Q, Left) :-
    !,
    side(P, Q, A, SideA),
    side(P, Q, B, SideB),
    (   SideA >= 0
    ->  Left = [A|Left1]
    ;   Left = Left1
    ),
    (   SideA*SideB < 0
    ->  A = XA-YA,
        B = XB-YB,
        T is SideA/(SideA-SideB),
        X is XA+T*(XB-XA),
        Y is YA+T*(YB-YA),
        Left1 = [X-Y|Left2]
    ;   Left1 = Left2
    ),
    clip_corners([B|Corners], P, Q, Left2).
clip_corners(_, _, _, []).

side(XP-YP, XQ-YQ, X-Y, Side) :-
    Side is (XQ-XP)*(Y-YP)-(YQ-YP)*(X-XP).

area(Corners, Area) :-
    (   Corners = [First|_]
    ->  append(Corners, [First], Closed),
        shoelace(Closed, 0, Area)
    ;   Area = 0
    ).

shoelace([XA-YA, XB-YB|Corners], Sum, Area) :-
    !,
    Next is Sum+(XA*YB-XB*YA)/2,
    shoelace([XB-YB|Corners], Next, Area).
shoelace(_, Area, Area).

%   convex_hull(+Corners, -Hull): counterclockwise (Andrew's monotone chain).
convex_hull(Corners, Hull) :-
    sort(Corners, Sorted),
    reverse(Sorted, Backwards),
    chain(Sorted, [], [_|Lower]),
    chain(Backwards, [], [_|Upper]),
    append(Upper, Lower, Clockwise),
    reverse(Clockwise, Hull).

%   chain(+Corners, +Before, -Chain): the part of the hull that turns left, last corner first.
chain([], Chain, Chain).
chain([C|Corners], [B, A|Chain], Hull) :-
    side(A, B, C, Side),
    Side =< 0,
    !,
    chain([C|Corners], [A|Chain], Hull).
chain([C|Corners], Chain, Hull) :-
    chain(Corners, [C|Chain], Hull).
