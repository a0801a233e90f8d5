:- module(grammar, [ meaning//4 ]).     % -Kind, -Relation, -Sought, -Goal
:- use_module(library(lists)).
:- use_module(lexicon).

/** <module> The grammar of phrases

A definite clause grammar. What is meant is a goal in the vocabulary; in it
'$the'(Thing, Noun) marks a thing that was called by "the", of which there should
be one. Quantifiers become logic: "a cup" is some cup, "all cups" forall/2, "no
cup" a negation, "the largest cup" maximal/2 of everything that is said of it.
*/

%!  meaning(-Kind, -Relation, -Sought, -Goal)// is nondet.
%
%   Kind is `thing` (Sought are what is asked for), `place` (Relation leads from the
%   landmarks Sought to it) or `question` (Sought is a number, a value or nothing).

meaning(Kind, Relation, Sought, Goal) -->
    polite,
    sought(Kind, Relation, Sought, Goal),
    ( [please] ; [] ).

polite --> [please], !.
polite --> [tell, me], !.
polite --> [].

sought(question, none, Sought, Goal) --> question(Sought, Goal).
sought(thing, none, [Thing], Goal) --> which(Thing, Goal).
sought(thing, none, [Thing], Goal) -->
    [where, can], ( [i] ; [the, robot] ), ability(Thing, Goal).
sought(Kind, Relation, Sought, Goal) --> lead_in, meant(Kind, Relation, Sought, Goal).

lead_in --> [where], ( [is] ; [are] ; [can, i, find] ), !.
lead_in --> [go], ( [to] ; [] ), !.
lead_in --> [take, me, to], !.
lead_in --> ( [find] ; [list] ), !.
lead_in --> [show], ( [me] ; [] ), !.
lead_in --> [bring, me], !.
lead_in --> [look, for], !.
lead_in --> [i, am, looking, for], !.
lead_in --> [].

meant(place, between, [A, B], (GoalA, GoalB)) -->
    somewhere, [between], !,
    noun_phrase(A, _, _, GoalA),
    [and],
    noun_phrase(B, _, _, GoalB).
meant(place, Relation, [Landmark], (RoomGoal, Goal, in(Landmark, Room))) -->
    somewhere, [in],
    bare_noun_phrase(Room, Noun, _, RoomGoal),
    { means_room(Noun) },
    preposition(Relation),
    noun_phrase(Landmark, _, _, Goal).
meant(place, Relation, [Landmark], Goal) -->
    somewhere,
    preposition(Relation),
    noun_phrase(Landmark, _, _, Goal).
meant(thing, none, [Thing], Goal) -->
    noun_phrase(Thing, _, Quantifier, Goal),
    { Quantifier \== no }.

somewhere --> [somewhere], !.
somewhere --> [].

                /*******************************
                *         NOUN PHRASES         *
                *******************************/

%   noun_phrase(?Thing, -Noun, -Quantifier, -Goal): Goal holds of what is meant.
noun_phrase(Robot, robot, some, asker(Robot)) --> [me], !.
noun_phrase(Thing, Noun, Quantifier, Goal) -->
    noun_phrase(Thing, Noun, Quantifier, modified, Goal).

%   Without what may follow the noun.
bare_noun_phrase(Thing, Noun, Quantifier, Goal) -->
    noun_phrase(Thing, Noun, Quantifier, bare, Goal).

noun_phrase(Thing, Noun, Quantifier, Form, Goal) -->
    determiner(Quantifier, Number0),
    described_noun(Thing, Noun, Number, Form, Goal0),
    { ( Quantifier == the, Number == singular, Number0 \== plural
      ->  Goal = (Goal0, '$the'(Thing, Noun))
      ;   Goal = Goal0
      ) }.

%   described_noun(?Thing, -Noun, -Number, +Form, -Goal): a noun with all that is said of it.
described_noun(Thing, Noun, Number, Form, Goal) -->
    qualities(Thing, Parts, Parts1, Noun),
    noun(Thing, Noun, Number, NounGoal),
    after_noun(Form, Thing, Noun, Parts1, []),
    { put_together([holds(NounGoal)|Parts], Noun, Goal) }.

after_noun(bare, _, _, Parts, Parts) --> [].
after_noun(modified, Thing, Noun, Parts, Rest) --> modifiers(Thing, Noun, Parts, Rest).

%   qualities(?Thing, -Parts, ?Rest, ?Noun): adjectives and superlatives before the noun.
qualities(Thing, [Part|Parts], Rest, Noun) -->
    quality(Thing, Noun, Part),
    qualities(Thing, Parts, Rest, Noun).
qualities(_, Rest, Rest, _) --> [].

quality(Thing, Noun, best(How, Measure, Thing, Noun)) --> superlative(How, Measure).
quality(Thing, _, holds(Goal)) --> adjective(Thing, Goal).

%   modifiers(?Thing, +Noun, -Parts, ?Rest): what follows the noun.
modifiers(Thing, Noun, [Part|Parts], Rest) -->
    modifier(Thing, Noun, Part),
    ( [and] ; [] ),
    modifiers(Thing, Noun, Parts, Rest).
modifiers(_, _, Rest, Rest) --> [].

modifier(Thing, _, best(most, seen, Thing, _)) -->
    ( relative ; [] ), ( [i, saw, last] ; [seen, last] ; [was, seen, last] ), !.
modifier(Thing, Noun, best(How, near_to(Other, OtherGoal), Thing, Noun)) -->
    ( relative, to_be(_) ; [] ),
    superlative(How, near), to_or_from,
    noun_phrase(Other, _, _, OtherGoal).
modifier(Thing, Noun, to(Other, OtherGoal)) -->
    to_or_from,
    { nonvar(Noun), var(Thing) },
    noun_phrase(Other, _, _, OtherGoal).
modifier(Thing, Noun, holds(Goal)) -->
    [with], whatever(Y, Quantifier, Restriction), preposition(Relation), ( [it] ; [them] ), !,
    { nonvar(Noun),
      Literal =.. [Relation, Y, Thing],
      quantified(Quantifier, Y, Restriction, Literal, Goal) }.
modifier(Thing, Noun, holds(Goal)) -->
    [with], !,
    having(Thing, Noun, Goal).
modifier(Thing, Noun, holds(\+ Goal)) -->
    [without], !,
    having(Thing, Noun, Goal).
modifier(Thing, Noun, holds(Goal)) -->
    relative,
    clause(Thing, Noun, Goal).
modifier(Thing, Noun, holds(Goal)) -->
    placed(Thing, Noun, Goal).
modifier(Thing, _, holds(Goal)) -->
    compared(Thing, Goal).

relative --> ( [that] ; [which] ; [who] ).
to_or_from --> ( [to] ; [from] ).

to_be(singular) --> [is].
to_be(plural) --> [are].

%   put_together(+Parts, +Noun, -Goal): a superlative is of all else that is said.
put_together(Parts0, Noun, Goal) :-
    nearest_to(Parts0, Parts),
    findall_parts(Parts, Goals, Bests),
    conjunction(Goals, Plain),
    foldl_best(Bests, Noun, Plain, Goal).

%   "the nearest chair to the oven": what it is near to stands after the noun.
nearest_to(Parts, Joined) :-
    (   select(best(How, near, Thing, Noun), Parts, Parts1),
        select(to(Other, Goal), Parts1, Parts2)
    ->  append(Parts2, [best(How, near_to(Other, Goal), Thing, Noun)], Joined)
    ;   Joined = Parts
    ),
    \+ memberchk(to(_, _), Joined).

findall_parts([], [], []).
findall_parts([holds(Goal)|Parts], [Goal|Goals], Bests) :- findall_parts(Parts, Goals, Bests).
findall_parts([Best|Parts], Goals, [Best|Bests]) :-
    Best = best(_, _, _, _),
    findall_parts(Parts, Goals, Bests).

conjunction([Goal], Goal) :- !.
conjunction([Goal|Goals], (Goal, Rest)) :- conjunction(Goals, Rest).

foldl_best([], _, Goal, Goal).
foldl_best([best(How, Measure, Thing, _)|Bests], Noun, Goal0, Goal) :-
    measured_by(Measure, Noun, Thing, Value, Extra),
    ( How == most -> Best = maximal(Value, (Goal0, Extra)) ; Best = minimal(Value, (Goal0, Extra)) ),
    foldl_best(Bests, Noun, Best, Goal).

measured_by(extent, Noun, Thing, Value, Goal) :-
    ( nonvar(Noun), means_room(Noun) -> Goal = area(Thing, Value) ; Goal = volume(Thing, Value) ).
measured_by(height, _, Thing, Value, height(Thing, Value)).
measured_by(width, _, Thing, Value, width(Thing, Value)).
measured_by(elevation, _, Thing, Value, position(Thing, _, _, Value)).
measured_by(seen, _, Thing, Value, seen(Thing, _, Value)).
measured_by(near, _, Thing, Value, (asker(Robot), distance(Thing, Robot, Value))).
measured_by(near_to(Other, Goal), _, Thing, Value, (Goal, distance(Thing, Other, Value))).

                /*******************************
                *     WHAT IS SAID OF ONE      *
                *******************************/

%   clause(?Thing, +Noun, -Goal): a verb and what follows it, after "which" or a subject.
clause(Thing, Noun, Goal) -->
    to_be(_), !,
    predicate(Thing, Noun, Goal).
clause(Thing, Noun, Goal) -->
    clause_with_verb(Thing, Noun, Goal).

clause_with_verb(Thing, Noun, \+ Goal) -->
    ( [does, not] ; [do, not] ), !,
    verb(plural, Relation),
    related(Relation, Thing, Noun, Goal).
clause_with_verb(Thing, _, Goal) -->
    ( [i] ; [the, robot] ), [can], !,
    ability(Thing, Goal).
clause_with_verb(Thing, _, \+ Goal) -->
    ( [i] ; [the, robot] ), [cannot], !,
    ability(Thing, Goal).
clause_with_verb(Thing, Noun, Goal) -->
    verb(_, Relation),
    related(Relation, Thing, Noun, Goal).

related(have, Thing, Noun, Goal) --> !, having(Thing, Noun, Goal).
related(Relation, Thing, _, Goal) -->
    whatever(Other, Quantifier, Restriction),
    { Literal =.. [Relation, Thing, Other],
      quantified(Quantifier, Other, Restriction, Literal, Goal) }.

%   having(?Thing, +Noun, -Goal): a room has what is in it and its doors; another thing what is in it, on it or part of it.
having(Thing, Noun, Goal) -->
    having_one(Thing, Noun, First),
    ( [and], having(Thing, Noun, More), { Goal = (First, More) }
    ; { Goal = First }
    ).

having_one(Thing, Noun, Goal) -->
    noun_phrase(Other, OtherNoun, Quantifier, Restriction),
    { has(Noun, OtherNoun, Thing, Other, Literal),
      quantified(Quantifier, Other, Restriction, Literal, Goal) }.

has(Noun, OtherNoun, Room, Other, Goal) :-
    nonvar(Noun),
    means_room(Noun),
    !,
    (   memberchk(OtherNoun, [door, doorway, opening])
    ->  Goal = connects(Other, Room)
    ;   Goal = in(Other, Room)
    ).
has(_, _, Thing, Other, (in(Other, Thing) ; on(Other, Thing) ; part_of(Other, Thing))).

%   predicate(?Thing, +Noun, -Goal): what follows "is".
predicate(Thing, Noun, Goal) -->
    simple_predicate(Thing, Noun, First),
    more_predicates(Thing, Noun, First, Goal).

more_predicates(Thing, Noun, First, (First, Goal)) -->
    [and], predicate(Thing, Noun, Goal).
more_predicates(Thing, Noun, First, (First ; Goal)) -->
    [or], predicate(Thing, Noun, Goal).
more_predicates(_, _, Goal, Goal) --> [].

simple_predicate(Thing, Noun, Goal) --> placed(Thing, Noun, Goal).
simple_predicate(Thing, Noun, \+ Goal) --> [not], !, simple_predicate(Thing, Noun, Goal).
simple_predicate(Thing, _, Goal) --> adjective(Thing, Goal).
simple_predicate(Thing, _, Goal) --> compared(Thing, Goal).
simple_predicate(Thing, Noun, Goal) -->
    ( [the] ; [] ),
    superlative(How, near), to_or_from,
    noun_phrase(Other, _, _, OtherGoal),
    { nonvar(Noun),
      put_together([holds(instance_of(Thing, Noun)), best(How, near_to(Other, OtherGoal), Thing, Noun)], Noun, Goal) }.
simple_predicate(Thing, _, Goal) -->
    determiner(Quantifier, _),
    { Quantifier \== no, Quantifier \== all },
    described_noun(Thing, _, _, modified, Goal).

%   compared(?Thing, -Goal): larger, taller, wider than another thing or a length.
compared(Thing, Goal) -->
    comparative(Thing, Comparison), [than],
    compared_with(Comparison, Goal).

compared_with(values(Property, Sign, Thing), (Measure, Test)) -->
    metres(Limit),
    { Measure =.. [Property, Thing, Value],
      Test =.. [Sign, Value, Limit] }.
compared_with(values(Property, Sign, Thing), Goal) -->
    whatever(Other, Quantifier, Restriction),
    { Mine =.. [Property, Thing, Value],
      Theirs =.. [Property, Other, OtherValue],
      Test =.. [Sign, Value, OtherValue],
      quantified(Quantifier, Other, Restriction, (Mine, Theirs, Test), Goal) }.
compared_with(than(Other, Literal), Goal) -->
    whatever(Other, Quantifier, Restriction),
    { quantified(Quantifier, Other, Restriction, Literal, Goal) }.

metres(Metres) -->
    [Word],
    { atom_number(Word, Number) },
    unit(Scale),
    { Metres is Number*Scale }.

unit(1) --> ( [m] ; [metres] ; [meters] ; [metre] ; [meter] ).
unit(0.01) --> ( [cm] ; [centimetres] ; [centimeters] ).

%   placed(?Thing, +Noun, -Goal): where it is.
placed(Thing, Noun, \+ Goal) -->
    [not],
    placed(Thing, Noun, Goal).
placed(Thing, _, ((GoalA, GoalB), between(Thing, A, B))) -->
    [between], !,
    noun_phrase(A, _, _, GoalA),
    [and],
    noun_phrase(B, _, _, GoalB).
placed(Thing, Noun, Goal) -->
    within_metres(Sign, Limit),
    whatever(Other, Quantifier, Restriction),
    { Test =.. [Sign, Metres, Limit],
      Apart = (distance(Thing, Other, Metres), Test),
      ( var(Noun) -> Statement = (object(Thing), Apart) ; Statement = Apart ),
      quantified(Quantifier, Other, Restriction, Statement, Goal) }.
placed(Thing, Noun, Goal) -->
    preposition(Relation0),
    { relation_between(Relation0, Noun, Relation) },
    at_landmarks(Relation, Thing, Goal).

%   at_landmarks(+Relation, ?Thing, -Goal): "on a desk or a shelf".
at_landmarks(Relation, Thing, Goal) -->
    whatever(Other, Quantifier, Restriction),
    { Literal =.. [Relation, Thing, Other],
      quantified(Quantifier, Other, Restriction, Literal, First) },
    (   [or], at_landmarks(Relation, Thing, More), { Goal = (First ; More) }
    ;   [and], at_landmarks(Relation, Thing, More), { Goal = (First, More) }
    ;   { Goal = First }
    ).

within_metres(=<, Metres) --> [within], metres(Metres), [of].
within_metres(>, Metres) --> [more, than], metres(Metres), [from].

%   Rooms are next to each other when a door joins them.
relation_between(next_to, Noun, adjacent) :-
    nonvar(Noun),
    means_room(Noun),
    !.
relation_between(Relation, _, Relation).

whatever(Thing, Quantifier, Goal) --> noun_phrase(Thing, _, Quantifier, Goal).

%   quantified(+Quantifier, ?Thing, +Restriction, +Statement, -Goal): a class on its own stands for any instance.
quantified(all, _, Restriction, Statement, forall(Restriction, Statement)).
quantified(no, _, Restriction, Statement, \+ (Restriction, Statement)).
quantified(the, _, Restriction, Statement, (Restriction, Statement)).
quantified(some, Thing, Restriction, Statement, Goal) :-
    (   Restriction = instance_of(_, Class),
        Statement =.. [Word, _, _],
        \+ memberchk(Word, [(','), (;), (=), (->), forall, maximal, minimal])
    ->  Thing = Class,
        Goal = Statement
    ;   Goal = (Restriction, Statement)
    ).

                /*******************************
                *          QUESTIONS           *
                *******************************/

%   which(?Thing, -Goal): questions that are answered by things.
which(Thing, Goal) -->
    ( [what] ; [who] ), to_be(_),
    predicate(Thing, _, Goal).
which(Thing, Goal) -->
    [what], clause_with_verb(Thing, _, Goal).
which(Thing, Goal) -->
    [what],
    done_by_another(Thing, Goal).
which(Thing, Goal) -->
    [what, can], ( [i] ; [the, robot] ),
    ability(Thing, Goal).
which(Room, (Goal, in(Thing, Room), room(Room))) -->
    ( [which] ; [what] ), [room], to_be(_),
    noun_phrase(Thing, _, _, Goal), [in].
which(Thing, Goal) -->
    ( [which] ; [what] ), to_be(_), !,
    noun_phrase(Thing, _, _, Goal).
which(Thing, Goal) -->
    ( [which] ; [what] ),
    ( [of], determiner(_, _) ; [] ),
    described_noun(Thing, Noun, _, modified, NounGoal),
    said_of(Thing, Noun, NounGoal, Goal).

said_of(Thing, Noun, NounGoal, Goal) -->
    to_be(_), ( [the] ; [] ), best_predicate(Thing, Noun, NounGoal, Goal).
said_of(Thing, Noun, NounGoal, (NounGoal, Goal)) -->
    clause(Thing, Noun, Goal).
said_of(Thing, _, NounGoal, (NounGoal, Goal)) -->
    [can], ( [i] ; [the, robot] ),
    ability(Thing, Goal).
said_of(Thing, _, NounGoal, (NounGoal, Goal)) -->
    done_by_another(Thing, Goal).
said_of(Thing, Noun, NounGoal, Goal) -->
    [did, i], ( [see, last] ; [last, see] ),
    { put_together([holds(NounGoal), best(most, seen, Thing, Noun)], Noun, Goal) }.
said_of(_, _, Goal, Goal) --> ( [are, there] ; [is, there] ).

%   done_by_another(?Thing, -Goal): "what does the table support".
done_by_another(Thing, (Goal, Literal)) -->
    ( [does] ; [do] ),
    noun_phrase(Other, Noun, _, Goal),
    verb(plural, Relation),
    { ( Relation == have -> has(Noun, thing, Other, Thing, Literal) ; Literal =.. [Relation, Other, Thing] ) }.

best_predicate(Thing, Noun, NounGoal, Goal) -->
    superlative(How, near), to_or_from,
    noun_phrase(Other, _, _, OtherGoal),
    { put_together([holds(NounGoal), best(How, near_to(Other, OtherGoal), Thing, Noun)], Noun, Goal) }.
best_predicate(Thing, Noun, NounGoal, Goal) -->
    superlative(How, Measure),
    { put_together([holds(NounGoal), best(How, Measure, Thing, Noun)], Noun, Goal) }.

%   question(-Sought, -Goal): questions that are answered by a number, a value, or yes and no.
question([count(Number)], (aggregate_all(set(Thing), Goal, Things), length(Things, Number))) -->
    [how, many],
    described_noun(Thing, Noun, _, modified, NounGoal),
    counted(Thing, Noun, NounGoal, Goal).
question([metres(Metres)], (GoalA, GoalB, distance(A, B, Metres))) -->
    [how, far],
    ( to_be(_), noun_phrase(A, _, _, GoalA), [from] ; [from] , noun_phrase(A, _, _, GoalA), [to] ),
    noun_phrase(B, _, _, GoalB).
question([Sought], (Goal, Measure)) -->
    [how],
    dimension(Property),
    to_be(_),
    noun_phrase(Thing, Noun, _, Goal),
    { ( Property == size, means_room(Noun)
      ->  Measure = area(Thing, Value), Sought = square_metres(Value)
      ;   Measure =.. [Property, Thing, Value], Sought = metres(Value)
      ) }.
question([Sought], (Goal, Measure)) -->
    [what], to_be(_), [the],
    property(Property, Value, Sought), [of],
    noun_phrase(Thing, _, _, Goal),
    { Measure =.. [Property, Thing, Value] }.
question([color(Color)], (Goal, color(Thing, Color))) -->
    [what], ( ( [color] ; [colour] ), to_be(_) ; to_be(_), [the], ( [color] ; [colour] ), [of] ),
    noun_phrase(Thing, _, _, Goal).
question([type(Type)], (Goal, room_type(Room, Type))) -->
    [what], ( [kind] ; [type] ), [of, room], to_be(_),
    noun_phrase(Room, _, _, Goal).
question([time(Last)], (Goal, seen(Thing, _, Last))) -->
    [when],
    ( [did, i], ( [last] ; [] ), [see], noun_phrase(Thing, _, _, Goal), ( [last] ; [] )
    ; [was], bare_noun_phrase(Thing, _, _, Goal), ( [last, seen] ; [seen, last] ) ).
question([], Goal) -->
    to_be(_), [there],
    existing(Goal).
question([], Goal) -->
    to_be(_),
    subject(Thing, Noun, Quantifier, Restriction),
    predicate(Thing, Noun, Statement),
    { quantified(Quantifier, Thing, Restriction, Statement, Goal) }.
question([], Goal) -->
    ( [does] ; [do] ),
    subject(Thing, Noun, Quantifier, Restriction),
    ( [not], { Negated = true } ; { Negated = false } ),
    verb(plural, Relation),
    related(Relation, Thing, Noun, Statement0),
    { ( Negated == true -> Statement = (\+ Statement0) ; Statement = Statement0 ),
      quantified(Quantifier, Thing, Restriction, Statement, Goal) }.
question([], Goal) -->
    [can], ( [i] ; [the, robot] ),
    ability(Thing, Statement),
    noun_phrase(Thing, _, Quantifier, Restriction),
    { quantified(Quantifier, Thing, Restriction, Statement, Goal) }.

question([], Goal) -->
    somewhere_ahead([is, are]),
    subject(Thing, Noun, Quantifier, Restriction),
    to_be(_),
    predicate(Thing, Noun, Statement),
    { quantified(Quantifier, Thing, Restriction, Statement, Goal) }.

%   somewhere_ahead(+Words): one of Words comes yet: without it a long phrase need not be tried in all ways.
somewhere_ahead(Words, Text, Text) :-
    member(Word, Words),
    memberchk(Word, Text),
    !.

%   subject(?Thing, -Noun, -Quantifier, -Goal): "the cups" are all of them.
subject(Thing, Noun, Quantifier, Goal) -->
    determiner(Quantifier0, _),
    described_noun(Thing, Noun, Number, modified, Goal0),
    { ( Quantifier0 == the, Number == plural -> Quantifier = all, Goal = Goal0
      ; Quantifier0 == the -> Quantifier = the, Goal = (Goal0, '$the'(Thing, Noun))
      ; Quantifier = Quantifier0, Goal = Goal0
      ) }.

existing(Goal) -->
    number_of(Sign, Number), !,
    described_noun(Thing, Noun, _, modified, NounGoal),
    ( placed(Thing, Noun, Place), { Inside = (NounGoal, Place) } ; { Inside = NounGoal } ),
    { Test =.. [Sign, Count, Number],
      Goal = (aggregate_all(set(Thing), Inside, Things), length(Things, Count), Test) }.
existing(Goal) -->
    noun_phrase(_, _, Quantifier, Goal0),
    { ( Quantifier == no -> Goal = (\+ Goal0) ; Goal = Goal0 ) }.

number_of(>=, Number) --> [at, least], numeral(Number).
number_of(>, Number) --> [more, than], numeral(Number).
number_of(=:=, Number) --> [exactly], numeral(Number).
number_of(>=, Number) --> numeral(Number).

numeral(Number) -->
    [Word],
    { ( atom_number(Word, Number), integer(Number) -> true ; nth1(Number, [one, two, three, four, five, six], Word) ) }.

counted(Thing, Noun, NounGoal, (NounGoal, Goal)) -->
    clause(Thing, Noun, Goal).
counted(Thing, Noun, NounGoal, Goal) -->
    ( [are, there] ; [is, there] ), !,
    ( placed(Thing, Noun, Place), { Goal = (NounGoal, Place) } ; { Goal = NounGoal } ).
counted(Thing, _, NounGoal, (NounGoal, Goal, in(Thing, Whole))) -->
    ( [does] ; [do] ),
    noun_phrase(Whole, Noun, _, Goal),
    ( [have] ; [contain] ),
    { means_room(Noun) }.
counted(Thing, _, NounGoal, (NounGoal, Goal)) -->
    [can], ( [i] ; [the, robot] ),
    ability(Thing, Goal).
counted(_, _, Goal, Goal) --> [].

dimension(height) --> ( [high] ; [tall] ).
dimension(width) --> [wide].
dimension(depth) --> [deep].
dimension(size) --> ( [large] ; [big] ; [long] ).

property(area, Value, square_metres(Value)) --> [area].
property(volume, Value, cubic_metres(Value)) --> [volume].
property(height, Value, metres(Value)) --> [height].
property(width, Value, metres(Value)) --> [width].
property(depth, Value, metres(Value)) --> [depth].
property(size, Value, metres(Value)) --> ( [size] ; [length] ).
