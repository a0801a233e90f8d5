:- use_module(home).
:- use_module(rules(facts)).
:- use_module(rules(viewpoint)).
:- use_module(library(plunit)).
:- use_module(library(lists)).

relation(A, B, Viewer, Relations) :-
    findall(R, seen_from(R, A, B, Viewer, _), Relations).

around(Degrees, Distance) :-
    X is Distance*cos(Degrees*pi/180),
    Y is Distance*sin(Degrees*pi/180),
    with([position(b, 0.0, 0.0, 0.0), position(a, X, Y, 0.0)]).

%   The viewer stands to the east and looks west: the north is on its right.
:- begin_tests(viewpoint).

test(in_front, true(R == [in_front_of])) :- around(0, 1), relation(a, b, point(5, 0, 1), R).
test(right, true(R == [right_of])) :- around(90, 1), relation(a, b, point(5, 0, 1), R).
test(behind, true(R == [behind])) :- around(180, 1), relation(a, b, point(5, 0, 1), R).
test(left, true(R == [left_of])) :- around(270, 1), relation(a, b, point(5, 0, 1), R).
test(exactly_one_holds_all_around, true(Odd == [])) :-
    findall(D-R, ( between(0, 359, D), around(D, 2.9), relation(a, b, point(5, 0, 1), R), \+ R = [_] ), Odd).
test(sectors_are_half_open, true(R == [in_front_of])) :-
    with([position(b, 0.0, 0.0, 0.0), position(a, 1.0, -1.0, 0.0)]), relation(a, b, point(5, 0, 1), R).
test(the_other_end_is_the_next_sector, true(R == [right_of])) :-
    with([position(b, 0.0, 0.0, 0.0), position(a, 1.0, 1.0, 0.0)]), relation(a, b, point(5, 0, 1), R).
test(out_of_reach_nothing_holds, true(R == [])) :- around(10, 3.1), relation(a, b, point(5, 0, 1), R).
test(the_opposite_viewer_exchanges, true(Odd == [])) :-
    findall(D, ( between(0, 359, D), Off is D+0.5, around(Off, 1),
                 relation(a, b, point(5, 0, 1), [R]), relation(a, b, point(-5, 0, 1), [S]),
                 \+ exchanged(R, S) ), Odd).
test(turning_the_world_changes_nothing, true(Odd == [])) :-
    findall(D, ( between(0, 359, D), T is D*pi/180,
                 XA is cos(T+0.3), YA is sin(T+0.3), XV is 4*cos(T), YV is 4*sin(T),
                 with([position(b, 0.0, 0.0, 0.0), position(a, XA, YA, 0.0)]),
                 relation(a, b, point(XV, YV, 0), R), R \== [in_front_of] ), Odd).
test(own_frame, true(R-F == left_of-own_frame(b))) :-
    with([position(b, 0.0, 0.0, 0.0), position(a, 0.0, 1.0, 0.0), attribute(b, front, 0.0)]),
    seen_from(R, a, b, none, [test(bearing, _, within, F, _)|_]).
test(no_front_no_relation, true(R == [])) :- around(0, 1), relation(a, b, none, R).
test(a_viewer_on_the_spot_sees_no_sides, true(R == [])) :- around(0, 1), relation(a, b, point(0.0, 0.0, 2), R).
test(distance, true(abs(D-3.0) < 1.0e-9)) :-
    with([position(b, 0.0, 0.0, 0.0), position(a, 1.0, 2.0, 2.0)]), distance(a, b, D).

exchanged(left_of, right_of).
exchanged(right_of, left_of).
exchanged(behind, in_front_of).
exchanged(in_front_of, behind).

:- end_tests(viewpoint).

:- begin_tests(between_them, [setup(with([ position(a, 0.0, 0.0, 0.5), position(b, 1.0, 0.0, 0.5),
        measured(path_gap_upper, a, c, 0.1), measured(path_gap_lower, a, c, 0.1),
        measured(path_gap_upper, b, c, 0.1), measured(path_gap_lower, b, c, 0.1) ]))]).

test(in_the_way, all(T == [c])) :- tell([position(c, 0.5, 0.0, 0.5), size(c, 0.1, 0.1, 0.2)]), between_them(a, b, T).
test(beside_the_way, fail) :- tell([position(c, 0.5, 0.2, 0.5), size(c, 0.1, 0.1, 0.2)]), between_them(a, b, c).
test(turned_into_the_way, all(T == [c])) :-
    tell([position(c, 0.5, 0.2, 0.5), size(c, 0.6, 0.02, 0.2), yaw(c, 1.5708)]), between_them(a, b, T).
test(too_low_to_matter, fail) :- tell([position(c, 0.5, 0.0, 0.0), size(c, 0.1, 0.1, 0.2)]), between_them(a, b, c).
test(beyond_the_end, fail) :-
    tell([position(c, 1.4, 0.0, 0.5), size(c, 0.1, 0.1, 0.2), yaw(c, 0)]), between_them(a, b, c).

:- end_tests(between_them).
