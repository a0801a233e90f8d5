:- module(facts,
          [ node/2,                     % ?Id, ?Layer
            label/2,                    % ?Id, ?Class
            named/2,                    % ?Id, ?String
            position/4,                 % ?Id, ?X, ?Y, ?Z
            size/4,                     % ?Id, ?SX, ?SY, ?SZ
            yaw/2,                      % ?Id, ?Radians
            outline/2,                  % ?Id, ?Corners
            confidence/2,               % ?Id, ?Confidence
            seen/3,                     % ?Id, ?FirstNs, ?LastNs
            attribute/3,                % ?Id, ?Key, ?Value
            measured/3,                 % ?Name, ?Id, ?Value
            measured/4,                 % ?Name, ?A, ?B, ?Value
            mutual/4,                   % +Name, ?A, ?B, ?Value
            edge/6,                     % ?Relation, ?A, ?B, ?Value, ?Threshold, ?Confidence
            told/1,                     % ?Term
            class_info/3,               % ?Class, ?Kind, ?Parent
            parameter/2,                % ?Name, ?Value
            unobserved/1,               % ?Region
            lasted/5,                   % ?Relation, ?A, ?B, ?From, ?To
            lived/5,                    % ?Id, ?Layer, ?Class, ?From, ?To
            had/5,                      % ?Id, ?Key, ?Value, ?From, ?To
            event/5,                    % ?Kind, ?Id, ?Ns, ?Other, ?Was
            sighted/3,                  % ?Id, ?FirstNs, ?LastNs
            past_relation/1,            % ?Relation
            told_past/1,                % ?Relation
            revision/1,                 % -Number
            new_revision/0,
            update/1,                   % +Stream
            forget_everything/0
          ]).

/** <module> The facts of the world, as the graph last told them

Everything else in the rule base derives from these ground facts. They change
through update/1 only, which replaces by key: a second position(object_1, ...)
takes the place of the first.

Measurements are kept one predicate a name, so that the pairs of one thing are
found by index from either side: measured(gap, object_1, B, Gap) and
measured(gap, A, object_1, Gap) both cost what they return, not what there is.
A measurement whose value is the atom `unknown` says that it was tried and that
unobserved space left it open.
*/

:- dynamic
    node/2, label/2, named/2, position/4, size/4, yaw/2, outline/2, confidence/2, seen/3,
    attribute/3, told/1, class_info/3, parameter/2, unobserved/1,
    lasted/5, lived/5, had/5, event/5, sighted/3, past_relation/1, told_past/1,
    stored_edge/6,                      % A, B, Relation, Value, Threshold, Confidence
    store/3,                            % measurement name, arity, predicate that keeps it
    current_revision/1.

current_revision(0).

%!  node(?Id, ?Layer) is nondet.
%
%   Id is a node of the graph; Layer is building, storey, room, place, object,
%   structure or agent.

%!  label(?Id, ?Class) is nondet.
%
%   Class is what Id is called, as an atom in lower snake case.

%!  named(?Id, ?Name:string) is nondet.
%
%   Id goes by Name. (It is told as name(Id, Name): name/2 is taken in Prolog.)

%!  position(?Id, ?X, ?Y, ?Z) is nondet.
%
%   Id's centre is at X, Y, Z in the map frame [m].

%!  size(?Id, ?SX, ?SY, ?SZ) is nondet.
%
%   Id's oriented box measures SX by SY on the ground and SZ in height [m].

%!  yaw(?Id, ?Angle) is nondet.
%
%   Id's box is turned by Angle about z [rad].

%!  outline(?Id, ?Corners:list) is nondet.
%
%   The convex ground projection of what was seen of Id: at least three corners
%   [X, Y], counterclockwise [m]. It is told to who asks for it, and not else.

%!  confidence(?Id, ?Confidence) is nondet.
%
%   Confidence, 0 to 1, that Id is what its label says.

%!  seen(?Id, ?First, ?Last) is nondet.
%
%   Id was first and last seen at these times [ns].

%!  attribute(?Id, ?Key, ?Value) is nondet.
%
%   Id's attribute Key has Value.

%!  told(?Term) is nondet.
%
%   Term is what an operator told.

%!  class_info(?Class, ?Kind, ?Parent) is nondet.
%
%   A label space has Class, a thing or stuff, below Parent or none.

%!  parameter(?Name, ?Value) is nondet.
%
%   A number of the map that rules need, such as voxel_size_m.

%!  unobserved(?Region) is nondet.
%
%   Part of Region, such as `world`, has not been seen.

%!  lasted(?Relation, ?A, ?B, ?From, ?To) is nondet.
%
%   The graph had the edge Relation(A, B) from From until To [ns], or `now`.
%   Told for the relations that told_past/1 has.

%!  lived(?Id, ?Layer, ?Class, ?From, ?To) is nondet.
%
%   The graph had the node Id, labelled Class, from From until To [ns], or `now`.

%!  had(?Id, ?Key, ?Value, ?From, ?To) is nondet.
%
%   The node Id had an attribute, a text or truth value, from From until To [ns],
%   or `now`; its name is the attribute `name`.

%!  event(?Kind, ?Id, ?Ns, ?Other, ?Was) is nondet.
%
%   Id appeared, moved, vanished, was merged into Other, split from Other or
%   relabelled from Was to Other; `none` where there is no Other or Was.

%!  sighted(?Id, ?First, ?Last) is nondet.
%
%   Id, which has gone, was first and last seen at these times [ns].

%!  past_relation(?Relation) is nondet.
%
%   The graph's history has edges of Relation.

%!  told_past(?Relation) is nondet.
%
%   What lasted/5 is told of; `all` when it is everything.

%!  revision(-Number:integer) is det.
%
%   Number grows with every update: what was derived at an older one is stale.

revision(Number) :-
    current_revision(Number).

%!  new_revision is det.
%
%   What was derived so far is stale.

new_revision :-
    retract(current_revision(Old)),
    New is Old+1,
    assertz(current_revision(New)).

%!  measured(?Name, ?Id, ?Value) is nondet.
%
%   True when the measurement Name of thing Id is Value (SI units).

measured(Name, Id, Value) :-
    store(Name, 3, Predicate),
    call(Predicate, Id, Value).

%!  measured(?Name, ?A, ?B, ?Value) is nondet.
%
%   True when the measurement Name of the pair A, B is Value (SI units).

measured(Name, A, B, Value) :-
    store(Name, 4, Predicate),
    call(Predicate, A, B, Value).

%!  mutual(+Name, ?A, ?B, ?Value) is nondet.
%
%   As measured/4 for a symmetric measurement, which is stored once, with A
%   before B in the standard order, and asked for in both.

mutual(Name, A, B, Value) :-
    store(Name, 4, Predicate),
    !,
    (   atom(A), atom(B)
    ->  (   A @< B
        ->  call(Predicate, A, B, Value)
        ;   call(Predicate, B, A, Value)
        )
    ;   call(Predicate, A, B, Value)
    ;   call(Predicate, B, A, Value)
    ).

%   Where the name of a measurement stands in a rule, it is looked up when the rule is compiled.
:- multifile user:goal_expansion/2.
:- dynamic user:goal_expansion/2.

user:goal_expansion(measured(Name, Id, Value), facts:Goal) :-
    atom(Name),
    facts:store(Name, 3, Predicate),
    Goal =.. [Predicate, Id, Value].
user:goal_expansion(measured(Name, A, B, Value), facts:Goal) :-
    atom(Name),
    facts:store(Name, 4, Predicate),
    Goal =.. [Predicate, A, B, Value].

%!  edge(?Relation, ?A, ?B, ?Value, ?Threshold, ?Confidence) is nondet.
%
%   True when the graph stores this edge and no rule derives it (what rooms
%   connect, what an operator told).

edge(Relation, A, B, Value, Threshold, Confidence) :-
    stored_edge(A, B, Relation, Value, Threshold, Confidence).

%!  update(+Stream) is det.
%
%   Carry out the changes read from Stream: put(Fact) stores Fact in the place
%   of one with the same key, add(Fact) stores one whose key is new, delete(Fact)
%   removes what has Fact's key (where variables match anything), forget(Id)
%   removes every fact about Id.
%
%   @error domain_error(fact, Term) for anything else; nothing is changed then
%          beyond what stood before it in Stream.

update(Stream) :-
    new_revision,
    repeat,
        read_term(Stream, Change, [module(facts)]),
        (   Change == end_of_file
        ->  !
        ;   change(Change),
            fail
        ).

change(put(Fact)) :-
    stored(Fact, Stored, Key),
    !,
    retractall(Key),
    assertz(Stored).
change(add(Fact)) :-
    stored(Fact, Stored, _),
    !,
    assertz(Stored).
change(delete(Fact)) :-
    stored(Fact, _, Key),
    !,
    retractall(Key).
change(forget(Id)) :-
    !,
    forget(Id).
change(Change) :-
    domain_error(fact, Change).

%   stored(+Fact, -Stored, -Key): how Fact is kept, and the pattern of what it replaces.

stored(node(Id, L), node(Id, L), node(Id, _)).
stored(label(Id, C), label(Id, C), label(Id, _)).
stored(name(Id, N), named(Id, N), named(Id, _)).
stored(position(Id, X, Y, Z), position(Id, X, Y, Z), position(Id, _, _, _)).
stored(size(Id, X, Y, Z), size(Id, X, Y, Z), size(Id, _, _, _)).
stored(yaw(Id, A), yaw(Id, A), yaw(Id, _)).
stored(outline(Id, C), outline(Id, C), outline(Id, _)).
stored(confidence(Id, C), confidence(Id, C), confidence(Id, _)).
stored(seen(Id, F, L), seen(Id, F, L), seen(Id, _, _)).
stored(attribute(Id, K, V), attribute(Id, K, V), attribute(Id, K, _)).
stored(told(T), told(T), told(T)).
stored(class_info(C, K, P), class_info(C, K, P), class_info(C, _, _)).
stored(parameter(N, V), parameter(N, V), parameter(N, _)).
stored(unobserved(R), unobserved(R), unobserved(R)).
stored(lasted(R, A, B, F, T), lasted(R, A, B, F, T), lasted(R, A, B, F, _)).
stored(lived(Id, L, C, F, T), lived(Id, L, C, F, T), lived(Id, L, C, F, _)).
stored(had(Id, K, V, F, T), had(Id, K, V, F, T), had(Id, K, V, F, _)).
stored(event(K, Id, N, O, W), event(K, Id, N, O, W), event(K, Id, N, O, W)).
stored(sighted(Id, F, L), sighted(Id, F, L), sighted(Id, _, _)).
stored(past_relation(R), past_relation(R), past_relation(R)).
stored(told_past(R), told_past(R), told_past(R)).
stored(edge(R, A, B, V, T, C), stored_edge(A, B, R, V, T, C), stored_edge(A, B, R, _, _, _)).
stored(measured(Name, Id, V), Stored, Key) :-
    keeper(Name, 3, Predicate),
    Stored =.. [Predicate, Id, V],
    Key =.. [Predicate, Id, _].
stored(measured(Name, A, B, V), Stored, Key) :-
    keeper(Name, 4, Predicate),
    Stored =.. [Predicate, A, B, V],
    Key =.. [Predicate, A, B, _].

keeper(Name, Arity, Predicate) :-
    store(Name, Arity, Predicate),
    !.
keeper(Name, Arity, Predicate) :-
    atom(Name),
    Kept is Arity-1,
    atom_concat(measured_, Name, Predicate),
    dynamic(Predicate/Kept),
    assertz(store(Name, Arity, Predicate)).

forget(Id) :-
    retractall(node(Id, _)),
    retractall(label(Id, _)),
    retractall(named(Id, _)),
    retractall(position(Id, _, _, _)),
    retractall(size(Id, _, _, _)),
    retractall(yaw(Id, _)),
    retractall(outline(Id, _)),
    retractall(confidence(Id, _)),
    retractall(seen(Id, _, _)),
    retractall(attribute(Id, _, _)),
    retractall(stored_edge(Id, _, _, _, _, _)),
    retractall(stored_edge(_, Id, _, _, _, _)),
    forall(store(_, 3, Unary),
           ( Key =.. [Unary, Id, _], retractall(Key) )),
    forall(store(_, 4, Binary),
           ( From =.. [Binary, Id, _, _], retractall(From),
             To =.. [Binary, _, Id, _], retractall(To) )).

%!  forget_everything is det.
%
%   Remove every fact (tests begin from here).

forget_everything :-
    forall(( member(Name/Arity,
                    [ node/2, label/2, named/2, position/4, size/4, yaw/2, outline/2, confidence/2, seen/3,
                      attribute/3, told/1, class_info/3, parameter/2, unobserved/1, stored_edge/6,
                      lasted/5, lived/5, had/5, event/5, sighted/3, past_relation/1, told_past/1 ])
           ; store(_, Kept, Name), Arity is Kept-1 ),
           ( functor(Any, Name, Arity), retractall(Any) )).

%   The measurements that the rules read exist from the start, so that asking for one before it was made is no error.

:- forall(member(Name, [longer_side, lowest, highest, footing_seen, rest_level]),
          keeper(Name, 3, _)).
:- forall(member(Name, [ contact, lowest_above, footprint_overlap, rise, structure_between, same_storey,
                         path_gap_upper, path_gap_lower, gap, drop, footing_inside, voxels_inside, footprint_share,
                         side_contact, top_contact, things_between, visible, possibly_visible, way_upper, way_lower,
                         clear_width, clear_below ]),
          keeper(Name, 4, _)).
