:- module(explain,
          [ explain/5                   % +Goal, +Names, +Rows, +Truth, -Explanations
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(solution_sequences)).
:- use_module(facts).
:- use_module(taxonomy).
:- use_module(spatial).
:- use_module(rooms).
:- use_module(viewpoint).
:- use_module(ways).
:- use_module(history).
:- use_module(affordances).
:- use_module(properties).
:- use_module(vocabulary).
:- use_module(readings).
:- use_module(told_words).

/** <module> Why, and why not

An explanation is

    because(Text, Truth, Rule, Tests, Evidence, Children)

with the goal as it was asked or as it was found to hold, the rule in words, the
tests that decided, test(Measurement, Value, Comparison, ThresholdName,
Threshold, Unit), the facts they rest on, and explanations of its parts. For a
goal that does not hold the children are the candidates that came closest.
*/

%   Explaining a few answers is enough to be believed, and keeps a reply short.
explained_answers(3).
candidates_shown(3).
candidates_weighed(200).

%!  explain(+Goal, +Names, +Rows, +Truth, -Explanations:list) is det.
%
%   Names is Bindings-All: the variables that an answer in Rows binds, in its
%   order, and all.

explain(Goal, Bindings-Names, Rows, true, Explanations) :-
    !,
    explained_answers(Most),
    findall(because(Text, true, "", [], [], Children),
            ( nth1(Index, Rows, Row),
              Index =< Most,
              copy_term(Goal-Bindings-Names, Copy-Bound-CopiedNames),
              maplist(bind, Bound, Row),
              answer_text(Bindings, Row, Text),
              once(proof(Copy, CopiedNames, true, Children, [])) ),
            Explanations).
explain(Goal, _-Names, _, unknown, [because("what is asked", unknown, "", [], [], Children)]) :-
    once(proof(Goal, Names, unknown, Children, [])),
    !.
explain(Goal, _-Names, _, Truth, [because("what is asked", Truth, "", [], [], [Child])]) :-
    why_not(Goal, Names, Child),
    !.
explain(_, _, _, _, []).

bind(_=Value, Value).

answer_text([], _, "what is asked") :- !.
answer_text(Bindings, Row, Text) :-
    maplist(equation, Bindings, Row, Equations),
    atomic_list_concat(Equations, ', ', Atom),
    atom_string(Atom, Text).

equation(Name=_, Value, Equation) :-
    format(atom(Equation), "~w = ~q", [Name, Value]).

                /*******************************
                *             WHY              *
                *******************************/

%   proof(+Goal, +Bindings, +Reading, -Explanations, ?Rest): one explanation a literal, for a solution of Goal.

proof(and(A, B), Names, Reading, List, Rest) :- !,
    proof(A, Names, Reading, List, List1),
    proof(B, Names, Reading, List1, Rest).
proof(or(A, B), Names, Reading, List, Rest) :- !,
    (   proof(A, Names, Reading, List, Rest)
    ;   proof(B, Names, Reading, List, Rest)
    ).
proof(if(A, B, C), Names, Reading, List, Rest) :- !,
    (   proof(A, Names, Reading, List, List1),
        proof(B, Names, Reading, List1, Rest)
    ;   proof(not(A), Names, Reading, List, List1),
        proof(C, Names, Reading, List1, Rest)
    ).
proof(once(A), Names, Reading, List, Rest) :- !,
    proof(A, Names, Reading, List, Rest).
proof(sequence(_, A), Names, Reading, List, Rest) :- !,
    proof(A, Names, Reading, List, Rest).
proof(literal(Call, Hidden, _), Names, Reading, [Because|Rest], Rest) :- !,
    (   possible_or_certain(Reading, Hidden, Call)
    *-> true
    ;   fail
    ),
    literal_because(Call, Hidden, Names, Because).
proof(plain(Call), Names, Reading, [because(Text, true, "", [], [], [])|Rest], Rest) :- !,
    readings(plain(Call), Certain, Possible),
    ( Reading == true -> call(Certain) ; call(Possible) ),
    text(Call, Names, Text).
proof(Goal, Names, Reading, [because(Text, Truth, Rule, [], [], Children)|Rest], Rest) :-
    readings(Goal, Certain, Possible),
    (   call(Certain)
    *-> Truth = true
    ;   Reading == unknown,
        call(Possible),
        Truth = unknown
    ),
    quantifier_rule(Goal, Truth, Rule),
    goal_text(Goal, Names, Text),
    findall(Child, decisive(Goal, Truth, Names, Child), Children).

%   decisive(+Goal, +Truth, +Names, -Because) is nondet: the candidates that decide what is said of all or of none.
decisive(not(A), true, Names, Because) :-
    once(why_not(A, Names, Because)).
decisive(not(A), Open, Names, Because) :-
    Open \== true,
    holding(A, Open, Names, Because).
decisive(all(A, B), true, Names, Because) :-
    holding(and(A, B), true, Names, Because).
decisive(all(A, B), Open, Names, Because) :-
    Open \== true,
    holding(and(A, not(B)), Open, Names, Because).
decisive(collect(_, _, A), Truth, Names, Because) :-
    ( Truth == unknown -> Reading = unknown ; Reading = true ),
    holding(A, Reading, Names, Because).
decisive(extreme(_, _, _, A), _, Names, Because) :-
    holding(A, true, Names, Because).

%   holding(+Goal, +Truth, +Names, -Because): the first solutions of Goal that are known to hold; or, with Truth
%   unknown, that are open; with false, those against which something that was said of all or of none fails.
holding(Goal, Truth, Names, Because) :-
    ( Truth == unknown -> Reading = unknown ; Reading = true ),
    candidates_shown(Most),
    limit(Most, proof(Goal, Names, Reading, Parts, [])),
    ( Truth == unknown -> \+ \+ ( member(because(_, unknown, _, _, _, _), Parts) ) ; true ),
    member(Because, Parts).

quantifier_rule(not(_), true, "no candidate is possible") :- !.
quantifier_rule(not(_), unknown, "nothing is known to hold it, but a candidate is open") :- !.
quantifier_rule(all(_, _), true, "it holds of every candidate") :- !.
quantifier_rule(all(_, _), unknown, "it is open for a candidate") :- !.
quantifier_rule(extreme(most, _, _, _), true, "no candidate may have more") :- !.
quantifier_rule(extreme(least, _, _, _), true, "no candidate may have less") :- !.
quantifier_rule(_, true, "every candidate is decided") :- !.
quantifier_rule(_, _, "a candidate is open").

possible_or_certain(true, Hidden, Call) :-
    readings(literal(Call, [], []), Certain, _),
    call(Certain),
    instances(Hidden).
possible_or_certain(unknown, Hidden, Call) :-
    possible_instances(Hidden),
    readings(literal(Call, [], []), _, Possible),
    call(Possible).

instances([]).
instances([Thing-Class|Hidden]) :-
    once(instance_of(Thing, Class)),
    instances(Hidden).

possible_instances([]).
possible_instances([Thing-Class|Hidden]) :-
    possible_instance(Thing, Class),
    possible_instances(Hidden).

literal_because(told_words:Call, Hidden, Names, because(Text, Truth, Rule, [], [], Children)) :-
    !,
    text(Call, Names, Text),
    rule_text(told_words:Call, Rule),
    findall(Class, ( member(Thing-Name, Hidden), class_because(Thing, Name, Class) ), Classes),
    (   member(Truth, [true, unknown]),
        told_clause(Call, Goal, Variables),
        once(proof(Goal, Variables, Truth, Parts, []))
    ->  append(Parts, Classes, Children)
    ;   Truth = unknown,
        Children = Classes
    ).
literal_because(Call, Hidden, Names, because(Text, Truth, Rule, Tests, Evidence, Children)) :-
    text(Call, Names, Text),
    rule_text(Call, Rule),
    (   reason(Call, Truth0, Tests0, Evidence0)
    ->  Truth = Truth0,
        maplist(with_unit, Tests0, Tests),
        Evidence = Evidence0
    ;   Truth = unknown,
        Tests = [],
        Evidence = []
    ),
    findall(Child, ( member(Thing-Class, Hidden), class_because(Thing, Class, Child) ), Children).

class_because('$some'(Class), _, Because) :-
    !,
    Because = because(Text, unknown, "part of the world is unobserved", [], [unobserved(world)], []),
    format(string(Text), "no ~w is known", [Class]).
class_because(Thing, Class, because(Text, true, "", [], Evidence, [])) :-
    format(string(Text), "instance_of(~q, ~q)", [Thing, Class]),
    reason(instance_of(Thing, Class), _, _, Evidence),
    !.

%   reason(+Call, -Truth, -Tests, -Evidence) is nondet: on what a literal with its values rests.

reason(Call, unknown, [], []) :-
    unseen(Call),
    !.
reason(Call, Truth, [], Evidence) :-
    past_word(Call),
    past_reason(Call, Truth, Evidence),
    !.
reason(Call, Truth, Tests, Evidence) :-
    spatial_call(Call, Relation, A, B),
    (   judged(Relation, A, B, Truth, Tests), Truth == true -> true
    ;   edge(_, _, _, _, _, _), stored(Call, Edge) -> Truth = true, Tests = [], Evidence = [Edge]
    ;   judged(Relation, A, B, Truth, Tests), Truth \== false -> true
    ;   judged(Relation, A, B, Truth, Tests) -> true
    ),
    !,
    (   var(Evidence)
    ->  findall(Fact, evidence(Tests, A, B, Fact), Evidence)
    ;   true
    ).
reason(Call, true, [], [Edge]) :-
    stored(Call, Edge),
    !.
reason(Call, true, Tests, Evidence) :-
    from_viewpoint(Call, Relation, A, B, Viewer),
    seen_from(Relation, A, B, Viewer, Tests),
    !,
    findall(position(Id, X, Y, Z), ( member(Id, [A, B, Viewer]), position(Id, X, Y, Z) ), Evidence).
reason(instance_of(Id, Class), true, [], Evidence) :-
    instance_of(Id, Class),
    !,
    findall(Fact, class_evidence(Id, Class, Fact), Evidence).
reason(Call, Truth, Tests, Evidence) :-
    offered(Call, Thing, Truth, Tests),
    !,
    findall(label(Thing, Label), label(Thing, Label), Evidence).
reason(cannot_be(Room, Type), Truth, [], [Reason]) :-
    excluded(Room, Type, Truth, Reason),
    !.
reason(room_type(Room, Type), true, [], [Reason]) :-
    room_type(Room, Type, Reason),
    !.
reason(Call, true, [], [node(Id, Layer)]) :-
    Call =.. [Layer, Id],
    node(Id, Layer),
    !.
reason(gap(A, B, _), true, [], [measured(gap, A, B, Value)]) :-
    mutual(gap, A, B, Value),
    !.
reason(between(A, B, C), true, [test(share_between, Share, >=, between_share, Enough)], Evidence) :-
    lies_between(A, B, C, Share),
    !,
    between_share(Enough),
    findall(position(Id, X, Y, Z), ( member(Id, [A, B, C]), position(Id, X, Y, Z) ), Evidence).
reason(leads_to(A, B), true, [], Evidence) :-
    way(A, B, Evidence),
    !.
reason(Call, true, [], [Call]) :-
    predicate_property(facts:Call, dynamic),
    catch(facts:Call, _, fail),
    !.
reason(Module:Call, true, [], [Call]) :-
    call(Module:Call),
    !.
reason(Call, true, [], Facts) :-
    Call \= _:_,
    call(vocabulary:Call),
    !,
    findall(Fact, rests_on(Call, Fact), Facts).

%   offered(+Call, ?Thing, -Truth, -Tests): what a thing affords, or the robot can do with it.
offered(Call, Thing, Truth, Tests) :-
    Call =.. [Word, Thing],
    (   affordance(Word)
    ->  affords(Word, Thing, Truth, Tests)
    ;   capability(Word),
        can(Word, Thing, Truth, Tests)
    ).

spatial_call(Call, Relation, A, B) :-
    Call =.. [Word, X, Y],
    (   inverse(Relation, Word)
    ->  A = Y, B = X
    ;   ( symmetric(Word) ; one_way(Word) ; on_demand(Word) ; inverse(Word, _) )
    ->  Relation = Word, A = X, B = Y
    ).

stored(Call, edge(Relation, A, B, Value, Threshold, Confidence)) :-
    Call =.. [Relation, A, B],
    edge(Relation, A, B, Value, Threshold, Confidence),
    !.

from_viewpoint(Call, Relation, A, B, Viewer) :-
    Call =.. [Relation, A, B|More],
    memberchk(Relation, [in_front_of, behind, left_of, right_of]),
    ( More = [Viewer] -> true ; viewer(Viewer) ).

evidence(Tests, A, B, measured(Name, A, B, Value)) :-
    member(test(Name, Value, _, _, _), Tests),
    ( measured(Name, A, B, Value) -> true ; measured(Name, B, A, Value) ).
evidence(_, A, B, seen(Id, First, Last)) :-
    member(Id, [A, B]),
    seen(Id, First, Last).

class_evidence(Id, _, label(Id, Label)) :- label(Id, Label).
class_evidence(Id, Class, subclass(Label, Class)) :- label(Id, Label), Label \== Class, once(subclass(Label, Class)).
class_evidence(Id, Class, room_type(Id, Class, Reason)) :- room_type(Id, Class, Reason).
class_evidence(Id, Class, named(Id, Name)) :- named(Id, Name), \+ label(Id, Class).
class_evidence(Id, Class, node(Id, Class)) :- node(Id, Class).

with_unit(test(Name, Value, Comparison, Threshold, Limit), test(Name, Value, Comparison, Threshold, Limit, Unit)) :-
    ( threshold(Threshold, _, Unit0, _) -> Unit = Unit0
    ; Threshold == between_share -> Unit = share
    ; assumed(Threshold, _, Unit0, _) -> Unit = Unit0
    ; memberchk(Threshold, [near_distance, contact_gap, reach, robot_width, no_way]) -> Unit = metre
    ; Unit = none
    ).

rule_text(told_words:Call, Text) :- !,
    functor(Call, Name, Arity),
    functor(Head, Name, Arity),
    told_word(Head, _, Documentation, Rules),
    format(string(Text), "~w/~d: ~w, by the rules ~w", [Name, Arity, Documentation, Rules]).
rule_text(_:Call, Text) :- !,
    functor(Call, Name, Arity),
    format(string(Text), "~w/~d: a user's rule", [Name, Arity]).
rule_text(Call, Text) :-
    functor(Call, Name, Arity),
    functor(Head, Name, Arity),
    (   signature(Head, Documentation)
    ->  format(string(Text), "~w/~d: ~w", [Name, Arity, Documentation])
    ;   Text = ""
    ).

                /*******************************
                *           WHY NOT            *
                *******************************/

%   why_not(+Goal, +Bindings, -Because): the first part that fails when those before it hold.

why_not(Goal, Names, Because) :-
    conjuncts(Goal, Parts, []),
    first_failure(Parts, true, Before, Part),
    failure(Part, Before, Names, Because).

conjuncts(and(A, B), Parts, Rest) :- !,
    conjuncts(A, Parts, Parts1),
    conjuncts(B, Parts1, Rest).
conjuncts(Goal, [Goal|Rest], Rest).

first_failure([Part|Parts], Before, Prefix, Failing) :-
    readings(Part, Certain, _),
    (   \+ \+ ( call(Before), call(Certain) )
    ->  first_failure(Parts, ( Before, Certain ), Prefix, Failing)
    ;   Prefix = Before,
        Failing = Part
    ).

failure(literal(told_words:Call, Hidden, _), Before, Names, because(Text, false, Rule, [], Missing, Children)) :- !,
    source_text(Call, Hidden, Names, Text),
    rule_text(told_words:Call, Rule),
    missing_classes(Hidden, Missing),
    candidates_shown(Shown),
    findall(Child,
            limit(Shown, ( call(Before), instances_of(Hidden), told_clause(Call, Goal, Variables),
                           once(why_not(Goal, Variables, Child)) )),
            Children0),
    list_to_set(Children0, Children).
failure(literal(Call, Hidden, _), Before, Names, because(Text, false, Rule, [], Evidence, Children)) :- !,
    source_text(Call, Hidden, Names, Text),
    rule_text(Call, Rule),
    missing_classes(Hidden, Missing),
    candidates_weighed(Most),
    findall(Distance-Child,
            limit(Most, ( call(Before), candidate(Call, Hidden, Names, Distance, Child) )),
            Children0),
    sort(Children0, Children1),
    candidates_shown(Shown),
    findall(C, ( nth1(I, Children1, _-C), I =< Shown ), Children),
    (   Missing == [],
        Children == [],
        spatial_call(Call, Relation, _, _)
    ->  Evidence = [no_measured_pair(Relation)]
    ;   Evidence = Missing
    ).
failure(plain(Call), Before, Names, because(Text, false, "", [], [], Children)) :- !,
    goal_text(plain(Call), Names, Text),
    candidates_shown(Shown),
    findall(Compared,
            ( distinct(Compared, limit(Shown, ( call(Before), text(Call, Names, Compared) ))),
              Compared \== Text ),
            Texts),
    findall(because(One, false, "", [], [], []), member(One, Texts), Children).
failure(or(A, B), Before, Names, because(Text, false, "neither holds", [], [], Children)) :- !,
    goal_text(or(A, B), Names, Text),
    findall(Child, ( member(Part, [A, B]), once(( call(Before), why_not(Part, Names, Child) )) ), Children).
failure(Part, Before, Names, because(Text, false, Rule, [], [], Children)) :-
    goal_text(Part, Names, Text),
    ( Part = not(_) -> Rule = "it holds of a candidate"
    ; Part = all(_, _) -> Rule = "a candidate is an exception"
    ; Part = collect(_, _, _) -> Rule = "it comes to something else"
    ; Rule = "" ),
    findall(Child, once_before(Before, decisive(Part, false, Names, Child)), Children).

once_before(Before, Goal) :-
    once(( call(Before), \+ \+ call(Goal) )),
    call(Goal).

missing_classes(Hidden, Missing) :-
    findall(no_instance(Class), ( member(_-Class, Hidden), \+ instance_of(_, Class) ), Missing).

candidate(Call, Hidden, Names, Distance, because(Text, Truth, "", Tests, Evidence, [])) :-
    spatial_call(Call, Relation, A, B),
    instances_of(Hidden),
    judged(Relation, A, B, Truth, Tests0),
    Truth \== true,
    shortfall(Tests0, Distance),
    text(Call, Names, Text),
    maplist(with_unit, Tests0, Tests),
    findall(Fact, evidence(Tests0, A, B, Fact), Evidence).

candidate(Call, Hidden, _, 0, because(Text, true, "", [], Facts, [])) :-
    instead(Call, Held),
    instances_of(Hidden),
    call(vocabulary:Held),
    text(Held, [], Text),
    findall(Fact, rests_on(Held, Fact), Facts).
candidate(Call, Hidden, Names, Distance, because(Text, Truth, "", Tests, [], [])) :-
    instances_of(Hidden),
    offered(Call, _, Truth, Tests0),
    Truth \== true,
    shortfall(Tests0, Distance),
    text(Call, Names, Text),
    maplist(with_unit, Tests0, Tests).

candidate(Call, _, Names, Distance, because(Text, false, "", Tests, Evidence, [])) :-
    past_word(Call),
    past_miss(Call, Distance, Tests0, Evidence),
    text(Call, Names, Text),
    maplist(with_unit, Tests0, Tests).

%   instead(+Call, -Other): what is true in the place of Call, which is false.
instead(Call, Other) :-
    Call =.. [Property, Thing, _],
    property_name(Property),
    !,
    Other =.. [Property, Thing, _].
instead(gap(A, B, _), gap(A, B, _)).
instead(distance(A, B, _), distance(A, B, _)).
instead(larger(A, B), larger(B, A)).
instead(room_type(Room, _), room_type(Room, _)).
instead(Call, Other) :-
    Call =.. [Word, _, Class|More],
    memberchk(Word/More, [nearest/[_], farthest/[_], largest/[], smallest/[], tallest/[], latest/[]]),
    Other =.. [Word, _, Class|More].

%   rests_on(+Call, -Fact) is nondet: the measured facts that a word is worked out from.
rests_on(color(A, _), attribute(A, color, Color)) :- attribute(A, color, Color).
rests_on(Call, size(A, X, Y, Z)) :-
    Call =.. [Word, A, _],
    memberchk(Word, [size, volume, height, width, depth, area, largest, smallest, tallest]),
    size(A, X, Y, Z).
rests_on(larger(A, B), size(Id, X, Y, Z)) :- member(Id, [A, B]), size(Id, X, Y, Z).
rests_on(latest(A, _), seen(A, First, Last)) :- seen(A, First, Last).
rests_on(distance(A, B, _), position(Id, X, Y, Z)) :- member(Id, [A, B]), position(Id, X, Y, Z).
rests_on(nearest(A, _, B), position(Id, X, Y, Z)) :- member(Id, [A, B]), position(Id, X, Y, Z).
rests_on(farthest(A, _, B), position(Id, X, Y, Z)) :- member(Id, [A, B]), position(Id, X, Y, Z).
rests_on(gap(A, B, _), measured(gap, A, B, Gap)) :- mutual(gap, A, B, Gap).
rests_on(adjacent(A, B), edge(connects, Door, Room, Value, Threshold, Confidence)) :-
    edge(connects, Door, A, _, _, _),
    edge(connects, Door, B, _, _, _),
    member(Room, [A, B]),
    edge(connects, Door, Room, Value, Threshold, Confidence).
rests_on(room_type(Room, Type), Reason) :- room_type(Room, Type, Reason).

instances_of([]).
instances_of([Thing-Class|Hidden]) :-
    instance_of(Thing, Class),
    instances_of(Hidden).

%   shortfall(+Tests, -Distance): how far the worst test is from its threshold, in thresholds; unknown comes first.
shortfall(Tests, Distance) :-
    findall(D, ( member(Test, Tests), short_by(Test, D) ), Ds),
    foldl(larger_of, Ds, 0, Distance).

short_by(test(_, Value, Comparison, _, Threshold), By) :-
    number(Value),
    number(Threshold),
    (   memberchk(Comparison, [>=, >])
    ->  Short is Threshold-Value
    ;   Short is Value-Threshold
    ),
    By is max(0, Short)/max(abs(Threshold), 0.1).

larger_of(A, B, C) :- C is max(A, B).

                /*******************************
                *             TEXT             *
                *******************************/

text(_:Call, Names, Text) :- !,
    text(Call, Names, Text).
text(Call, Names, Text) :-
    readable(Call, Readable),
    write_text(Readable, Names, Text).

%   An unseen instance is written as its class.
readable(Term, Term) :- \+ compound(Term), !.
readable('$some'(Class), Class) :- !.
readable(any(Class), Class) :- atom(Class), !.
readable(Term, Readable) :-
    Term =.. [Name|Arguments],
    maplist(readable, Arguments, Readables),
    Readable =.. [Name|Readables].

source_text(Call, Hidden, Names, Text) :-
    copy_term(Call-Hidden-Names, Copy-Classes-CopiedNames),
    maplist(as_class, Classes),
    text(Copy, CopiedNames, Text).

as_class(Class-Class).

goal_text(Goal, Names, Text) :-
    copy_term(Goal-Names, Copy-CopiedNames),
    source(Copy, Source),
    write_text(Source, CopiedNames, Text).

write_text(Term0, Names0, Text) :-
    copy_term(Term0-Names0, Term-Names),
    include(unbound, Names, Variables),
    term_variables(Variables, Named),
    term_variables(Term, All),
    maplist(nameless(Named), All),
    with_output_to(string(Text),
                   write_term(Term, [ quoted(true), variable_names(Variables), numbervars(true),
                                      spacing(next_argument), max_depth(50) ])).

nameless(Named, Variable) :-
    (   member(Other, Named),
        Other == Variable
    ->  true
    ;   Variable = '$VAR'('_')
    ).

unbound(_=Value) :- var(Value).

%   source(+Goal, -Source): a checked goal as it was asked.
source(literal(Call, Hidden, _), Source) :- !,
    maplist(as_class, Hidden),
    ( Call = _:Source -> true ; Source = Call ).
source(plain(Call), Call) :- !.
source(and(A, B), (SA, SB)) :- !, source(A, SA), source(B, SB).
source(or(A, B), (SA ; SB)) :- !, source(A, SA), source(B, SB).
source(if(A, B, C), (SA -> SB ; SC)) :- !, source(A, SA), source(B, SB), source(C, SC).
source(not(A), \+ SA) :- !, source(A, SA).
source(all(A, B), forall(SA, SB)) :- !, source(A, SA), source(B, SB).
source(once(A), once(SA)) :- !, source(A, SA).
source(sequence(How, A), Source) :- !, source(A, SA), How =.. List, append(List, [SA], Call), Source =.. Call.
source(extreme(most, Value, _, A), maximal(Value, SA)) :- !, source(A, SA).
source(extreme(least, Value, _, A), minimal(Value, SA)) :- !, source(A, SA).
source(collect(findall(T, Bag), _, A), findall(T, SA, Bag)) :- !, source(A, SA).
source(collect(aggregate_all(Spec, Result), _, A), aggregate_all(Spec, SA, Result)) :- source(A, SA).
