:- module(ordering, [ well_ordered/2 ]). % +Goal, -Ordered
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(aggregate)).
:- use_module(library(solution_sequences)).
:- use_module(facts).
:- use_module(vocabulary).

/** <module> In which order the parts of a question are asked

*cup(X), near(X, oven)* has the same answers as *near(X, oven), cup(X)*, but a
building has many cups and one oven. A conjunction is begun with the part that
has the fewest solutions, and goes on with what is then bound.

Only words that mean the same whatever is bound are moved, past each other; what
compares, computes, or is a user's own stays where it was written.
*/

%!  well_ordered(+Goal, -Ordered) is det.
%
%   Ordered is the checked Goal with the parts of its conjunctions in an order in
%   which they are quickly answered.

well_ordered(and(A, B), Ordered) :-
    conjuncts(and(A, B), Parts0, []),
    length(Parts0, Length),
    most_parts(Most),
    Length =< Most,
    !,
    maplist(well_ordered, Parts0, Parts),
    arranged(Parts, [], Arranged),
    conjunction(Arranged, Ordered).
well_ordered(or(A, B), or(OA, OB)) :- !,
    well_ordered(A, OA),
    well_ordered(B, OB).
well_ordered(not(A), not(OA)) :- !,
    well_ordered(A, OA).
well_ordered(all(A, B), all(OA, OB)) :- !,
    well_ordered(A, OA),
    well_ordered(B, OB).
well_ordered(collect(How, Template, A), collect(How, Template, OA)) :- !,
    well_ordered(A, OA).
well_ordered(extreme(How, Value, Template, A), extreme(How, Value, Template, OA)) :- !,
    well_ordered(A, OA).
well_ordered(Goal, Goal).

%   Longer conjunctions are asked as they are written: ordering them would take as long as asking.
most_parts(12).

conjuncts(and(A, B), Parts, Rest) :- !,
    conjuncts(A, Parts, Parts1),
    conjuncts(B, Parts1, Rest).
conjuncts(Goal, [Goal|Rest], Rest).

conjunction([Goal], Goal) :- !.
conjunction([Goal|Goals], and(Goal, Rest)) :-
    conjunction(Goals, Rest).

%   arranged(+Parts, +Bound, -Arranged): Bound are the variables that have values when the first of Parts is asked.
arranged([], _, []).
arranged([Part], _, [Part]) :- !.
arranged(Parts, Bound, [Next|Arranged]) :-
    first_choices(Parts, [], Choices),
    cheapest(Choices, Bound, Next),
    once(selectq(Next, Parts, Others)),
    term_variables(Bound-Next, Bound1),
    arranged(Others, Bound1, Arranged).

selectq(Part, [Other|Parts], Parts) :- Part == Other.
selectq(Part, [Other|Parts], [Other|Others]) :- selectq(Part, Parts, Others).

%   first_choices(+Parts, +Passed, -Choices): those that may be asked before all that stand before them.
first_choices([], _, []).
first_choices([Part|Parts], Passed, Choices) :-
    (   Passed == []
    ->  Choices = [Part|More]
    ;   may_move(Part),
        forall(member(Before, Passed), may_pass(Part, Before))
    ->  Choices = [Part|More]
    ;   Choices = More
    ),
    (   may_move(Part)
    ->  first_choices(Parts, [Part|Passed], More)
    ;   More = []
    ).

may_move(Part) :- of_class(Part, _, _), !.
may_move(Part) :- relates(Part).

%   may_pass(+Part, +Before): what is in something is asked after what may bind a place, which is in a room but is
%   not listed among what is in it.
may_pass(literal(Call, _, _), Before) :-
    functor(Call, Word, 2),
    memberchk(Word, [in, contains]),
    !,
    (   of_class(Before, _, _)
    ->  true
    ;   Before = literal(Other, _, _),
        functor(Other, Relation, 2),
        memberchk(Relation, [on, supports, above, under, attached_to, hanging_from])
    ).
may_pass(_, _).

of_class(literal(instance_of(Thing, Class), [], _), Thing, Class) :-
    atom(Class),
    \+ memberchk(Class, [object, room, place, agent, structure, building, storey]).

relates(literal(Call, _, _)) :-
    functor(Call, Word, 2),
    memberchk(Word, [on, supports, in, contains, above, under, near, touching, next_to, attached_to, hanging_from]).

cheapest([Part], _, Part) :- !.
cheapest([Part|Parts], Bound, Cheapest) :-
    cost(Part, Bound, Cost),
    foldl(cheaper(Bound), Parts, Cost-Part, _-Cheapest).

cheaper(Bound, Part, Least-Best, Now) :-
    (   Least =:= 0
    ->  Now = Least-Best
    ;   cost(Part, Bound, Cost),
        ( Cost < Least -> Now = Cost-Part ; Now = Least-Best )
    ).

%   cost(+Part, +Bound, -Cost): about how many solutions it has; beyond `many` all are as many.
cost(Part, Bound, Cost) :-
    of_class(Part, Thing, Class),
    !,
    ( given(Bound, Thing) -> Cost = 0 ; instances(Class, Cost) ).
cost(literal(Call, Hidden, _), Bound, Cost) :-
    Call =.. [_|Arguments],
    include(given(Bound), Arguments, Given),
    length(Given, Known),
    length(Arguments, All),
    (   Known =:= All
    ->  Cost = 0
    ;   Known > 0
    ->  Cost = 1
    ;   Hidden \== []
    ->  findall(Count, ( member(_-Class, Hidden), instances(Class, Count) ), Counts),
        min_list(Counts, Fewest),
        Cost is 2*Fewest
    ;   many(Many),
        Cost is 4*Many
    ).

given(_, Argument) :- nonvar(Argument), !.
given(Bound, Argument) :-
    member(Other, Bound),
    Other == Argument,
    !.

many(64).

instances(Class, Count) :-
    many(Many),
    aggregate_all(count, limit(Many, instance_of(_, Class)), Count).
