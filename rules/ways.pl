:- module(ways,
          [ adjacent/2,                 % ?A, ?B
            leads_to/2,                 % ?A, ?B
            possibly_leads_to/2,        % ?A, ?B
            way/3                       % +A, +B, -Doors
          ]).
:- use_module(library(lists)).
:- use_module(facts).
:- use_module(spatial, [robot_width/2]).
:- use_module(viewpoint, [viewer/1]).

/** <module> Which rooms lead to which

A door or opening D joins the rooms that it connects, edge(connects, D, Room,
Width, ...). A robot gets through when D is wider than the robot, and open or
openable: a shut door can be opened unless somebody told attribute(D, locked,
true). The robot is the one that asks, as in robot_width/2.
*/

%!  adjacent(?A, ?B) is nondet.
%
%   The rooms A and B share a door or opening.

adjacent(A, B) :-
    edge(adjacent, A, B, _, _, _).
adjacent(A, B) :-
    edge(connects, Door, A, _, _, _),
    edge(connects, Door, B, _, _, _),
    A \== B,
    \+ edge(adjacent, A, B, _, _, _).

%!  leads_to(?A, ?B) is nondet.
%
%   The robot gets from room A to another room B, through rooms and doors.

leads_to(A, B) :-
    reaches(certain, A, B).

%!  possibly_leads_to(?A, ?B) is nondet.
%
%   As leads_to/2, where a door of which the width is not known may be wide enough.

possibly_leads_to(A, B) :-
    reaches(possible, A, B).

reaches(Reading, A, B) :-
    node(A, room),
    robot(Robot),
    robot_width(Robot, Width),
    reached([A-[]], Reading, Width, [A-[]], Rooms),
    member(B-_, Rooms),
    B \== A.

%!  way(+A, +B, -Doors:list) is semidet.
%
%   Doors are those that a shortest way from room A to room B leads through, as
%   through(Door, Width), in order.

way(A, B, Doors) :-
    robot(Robot),
    robot_width(Robot, Width),
    reached([A-[]], certain, Width, [A-[]], Rooms),
    memberchk(B-Backwards, Rooms),
    reverse(Backwards, Doors).

%   reached(+Open, +Reading, +Width, +Seen, -Rooms): breadth first; each room with the doors behind it, last first.
reached([], _, _, Rooms, Rooms).
reached([Room-Doors|Open], Reading, Width, Seen, Rooms) :-
    findall(Next-[through(Door, Clear)|Doors],
            ( next_room(Reading, Width, Room, Next, Door, Clear), \+ memberchk(Next-_, Seen) ),
            Found),
    first_each(Found, Seen, New),
    append(Seen, New, Seen1),
    append(Open, New, Open1),
    reached(Open1, Reading, Width, Seen1, Rooms).

first_each([], _, []).
first_each([Room-_|Found], Seen, New) :-
    memberchk(Room-_, Seen),
    !,
    first_each(Found, Seen, New).
first_each([One|Found], Seen, [One|New]) :-
    first_each(Found, [One|Seen], New).

next_room(Reading, Width, Room, Next, Door, Clear) :-
    edge(connects, Door, Room, Clear, _, _),
    passable(Reading, Clear, Width),
    \+ attribute(Door, locked, true),
    edge(connects, Door, Next, _, _, _),
    Next \== Room.

passable(_, Clear, Width) :-
    number(Clear),
    !,
    Clear > Width.
passable(possible, _, _).

robot(Robot) :-
    viewer(Viewer),
    atom(Viewer),
    node(Viewer, agent),
    !,
    Robot = Viewer.
robot(_).
