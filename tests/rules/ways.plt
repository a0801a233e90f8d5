:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(viewpoint)).
:- use_module(rules(ways)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

%   kitchen =(door 0.9)= hall =(opening 0.6)= bedroom, and a cellar behind a hatch of unknown width.
rooms([ node(kitchen, room), node(hall, room), node(bedroom, room), node(cellar, room),
        edge(connects, door, kitchen, 0.9, 0.5, 1.0), edge(connects, door, hall, 0.9, 0.5, 1.0),
        edge(connects, gap, hall, 0.6, 0.5, 1.0), edge(connects, gap, bedroom, 0.6, 0.5, 1.0),
        edge(connects, hatch, hall, none, none, 1.0), edge(connects, hatch, cellar, none, none, 1.0),
        node(rob, agent), node(tom, agent), attribute(rob, width_m, 0.5), attribute(tom, width_m, 0.7) ]).

as(Viewer) :-
    rooms(Facts),
    with(Facts),
    set_viewer(Viewer).

led(A, Rooms) :-
    findall(B, leads_to(A, B), Rooms0),
    sort(Rooms0, Rooms).

:- begin_tests(ways, [cleanup(set_viewer(none))]).

test(through_several_doors, true(Rooms == [bedroom, hall])) :- as(rob), led(kitchen, Rooms).
test(a_wide_robot_stays_out, true(Rooms == [hall])) :- as(tom), led(kitchen, Rooms).
test(a_locked_door_is_no_way, true(Rooms == [bedroom])) :-
    as(rob),
    tell([attribute(door, locked, true)]),
    led(hall, Rooms).
test(an_unlocked_one_is, true(Rooms == [bedroom, kitchen])) :-
    as(rob),
    tell([attribute(door, locked, false)]),
    led(hall, Rooms).
test(a_width_that_is_not_known_may_do, true(Rooms == [bedroom, cellar, hall])) :-
    as(rob),
    findall(B, possibly_leads_to(kitchen, B), Rooms0),
    sort(Rooms0, Rooms).
test(both_ways, true(Odd == [])) :-
    as(rob),
    findall(A-B, ( leads_to(A, B), \+ leads_to(B, A) ), Odd).
test(the_way_names_its_doors, true(Doors == [through(door, 0.9), through(gap, 0.6)])) :-
    as(rob),
    way(kitchen, bedroom, Doors).
test(rooms_that_share_a_door_are_adjacent, true(Rooms == [bedroom, cellar, kitchen])) :-
    as(none),
    findall(B, adjacent(hall, B), Rooms0),
    sort(Rooms0, Rooms).

:- end_tests(ways).
