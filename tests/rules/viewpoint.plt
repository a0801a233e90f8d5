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

%   A sofa 2 m wide and a TV 1.2 m wide face each other 2 m apart; the table stands in the hull of both.
:- begin_tests(between, [setup(with([ node(sofa, object), position(sofa, 0.0, 0.0, 0.4), size(sofa, 2.0, 0.8, 0.8),
                                      node(tv, object), position(tv, 0.0, 3.0, 1.0), size(tv, 1.2, 0.2, 0.7),
                                      node(table, object) ]))]).

test(in_the_hull, all(Share == [1.0])) :-
    tell([position(table, 0.0, 1.5, 0.2), size(table, 0.8, 0.4, 0.4), yaw(table, 0.4)]),
    lies_between(table, sofa, tv, Share0),
    Share is round(Share0*1000)/1000.0.
test(the_order_of_the_two_does_not_matter, true(abs(S1-S2) < 1.0e-9)) :-
    lies_between(table, sofa, tv, S1),
    lies_between(table, tv, sofa, S2).
test(beside_is_not_between, fail) :-
    tell([position(table, 1.5, 1.5, 0.2)]),
    lies_between(table, sofa, tv, _).
test(what_stands_on_one_of_them_is_not_between, fail) :-
    tell([position(table, 0.0, 0.0, 0.9)]),
    lies_between(table, sofa, tv, _).
test(what_is_under_both_is_counted_out_once, all(Share == [0.6])) :-
    tell([ position(table, 0.0, 1.5, 0.0), size(table, 1.0, 2.0, 0.01), yaw(table, 0),
           node(a, object), position(a, 0.0, 0.5, 0.2), size(a, 3.0, 0.8, 0.4),
           node(b, object), position(b, 0.0, 2.5, 0.2), size(b, 3.0, 0.8, 0.4) ]),
    lies_between(table, a, b, Share0),
    Share is round(Share0*1000)/1000.0.
test(all_that_lie_there, all(Thing == [table])) :-
    lies_between(Thing, a, b, _),
    Thing == table.
test(turning_the_world_changes_nothing, true(( Share > 0.6, Share < 0.99, Odd == [] ))) :-
    share_turned_by(0, Share),
    findall(D, ( between(1, 35, N), D is N*10, share_turned_by(D, Other), abs(Share-Other) > 1.0e-9 ), Odd).

share_turned_by(Degrees, Share) :-
    T is Degrees*pi/180,
    turned(0.4, 1.4, T, XT, YT),
    turned(0.2, 3.0, T, XV, YV),
    YawT is T+0.7,
    with([ node(t, object), position(t, XT, YT, 0), size(t, 0.9, 0.5, 1), yaw(t, YawT),
           node(s, object), position(s, 0, 0, 0), size(s, 1.0, 0.8, 1), yaw(s, T),
           node(v, object), position(v, XV, YV, 0), size(v, 1.2, 0.2, 1), yaw(v, T) ]),
    ( lies_between(t, s, v, Share0) -> Share = Share0 ; Share = none ).

turned(X, Y, T, XT, YT) :-
    XT is X*cos(T)-Y*sin(T),
    YT is X*sin(T)+Y*cos(T).

:- end_tests(between).
