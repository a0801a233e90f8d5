:- module(affordances,
          [ affords/4,                  % ?Word, ?Thing, -Truth, -Tests
            affordance/1,               % ?Word
            affords_class/2,            % ?Word, ?Class
            can/4,                      % ?Word, ?Thing, -Truth, -Tests
            capability/1,               % ?Word
            typical_weight/3,           % ?Class, -Least, -Most
            asking/1,                   % -Robot
            assumed/4                   % ?Name, -Value, ?Unit, ?Reason
          ]).
:- use_module(library(lists)).
:- use_module(facts).
:- use_module(taxonomy).
:- use_module(spatial, [robot_width/2, judged/5]).
:- use_module(viewpoint, [viewer/1]).

/** <module> What can be done with a thing, and by whom

An affordance is what a thing offers anybody: it comes of its class, in
affords_class/2, or of an operator's word, attribute(Thing, Word, true) or
false, which beats the class. `graspable` also asks whether the thing is small
enough for a hand.

A capability is what the robot that asks can do with a thing: reach it, carry
it, fit through it. It comes of what the robot told of itself.

Both have three truth values: of a thing that was never measured, and of a robot
that did not describe itself, something stays unknown.

    ?- affords(graspable, cup_1, Truth, Tests).
    Truth = true,
    Tests = [test(grasp_width, 0.08, =<, hand_opening, 0.12)].
*/

%!  assumed(?Name, -Value, ?Unit, ?Reason) is nondet.
%
%   The numbers that decide here; attributes of the asking robot replace them.

assumed(hand_opening, 0.12, metre, "an adult's hand and most parallel grippers for household things close around 12 cm").
assumed(payload, 3.0, kilogram, "what an arm on a household robot carries, unless the robot says otherwise").

%!  affordance(?Word) is nondet.

affordance(graspable).
affordance(openable).
affordance(container).
affordance(surface).
affordance(sittable).
affordance(powered).
affordance(pourable).
affordance(movable).

%!  affords_class(?Word, ?Class) is nondet.
%
%   Things of Class, or of a class below it, offer Word.

affords_class(container, Class) :- holds_things(Class).
affords_class(openable, door).              affords_class(openable, window).
affords_class(openable, cabinet).           affords_class(openable, wardrobe).
affords_class(openable, drawer).            affords_class(openable, chest_of_drawers).
affords_class(openable, dresser).           affords_class(openable, oven).
affords_class(openable, fridge).            affords_class(openable, freezer).
affords_class(openable, dishwasher).        affords_class(openable, microwave).
affords_class(openable, washing_machine).   affords_class(openable, dryer).
affords_class(openable, bin).               affords_class(openable, box).
affords_class(openable, suitcase).          affords_class(openable, bag).
affords_class(openable, jar).               affords_class(openable, bottle).
affords_class(openable, curtain).           affords_class(openable, book).
affords_class(openable, laptop).            affords_class(openable, tap).
affords_class(surface, surface).            affords_class(surface, storage).
affords_class(surface, bed).                affords_class(surface, seat).
affords_class(surface, floor).              affords_class(surface, tray).
affords_class(surface, window_sill).        affords_class(surface, washing_machine).
affords_class(surface, dishwasher).         affords_class(surface, fridge).
affords_class(sittable, seat).              affords_class(sittable, bed).
affords_class(sittable, toilet).            affords_class(sittable, bathtub).
affords_class(powered, appliance).          affords_class(powered, electronics).
affords_class(powered, light).
affords_class(pourable, bottle).            affords_class(pourable, jug).
affords_class(pourable, kettle).            affords_class(pourable, cup).
affords_class(pourable, glass).             affords_class(pourable, bowl).
affords_class(pourable, can).               affords_class(pourable, pot).
affords_class(pourable, pan).               affords_class(pourable, jar).
affords_class(pourable, bucket).            affords_class(pourable, milk).
affords_class(pourable, cereal).            affords_class(pourable, vase).

%   immovable(?Class): nobody carries a thing of Class about, nor grasps it.
immovable(structure).       immovable(sanitary).        immovable(storage).
immovable(bed).             immovable(counter).         immovable(sofa).
immovable(oven).            immovable(stove).           immovable(fridge).
immovable(freezer).         immovable(dishwasher).      immovable(washing_machine).
immovable(dryer).           immovable(extractor_hood).  immovable(piano).
immovable(person).          immovable(cat).             immovable(dog).

%!  affords(?Word, ?Thing, -Truth, -Tests:list) is nondet.
%
%   Truth, of an object or a piece of structure: it offers Word. An operator's
%   word decides; else its class does, and for `graspable` its size too. Truth
%   is true, false or unknown; with an unbound Thing only what is not false is
%   enumerated.

affords(Word, Thing, Truth, Tests) :-
    nonvar(Thing),
    !,
    node(Thing, Layer),
    memberchk(Layer, [object, structure]),
    affordance(Word),
    offers(Word, Thing, Truth, Tests).
affords(Word, Thing, Truth, Tests) :-
    affordance(Word),
    offering(Word, Thing),
    offers(Word, Thing, Truth, Tests),
    Truth \== false.

%   offering(+Word, -Thing): each thing that may offer Word, once.
offering(Word, Thing) :-
    (   memberchk(Word, [graspable, movable])
    ->  node(Thing, object)
    ;   setof(T, offered(Word, T), Things),
        member(Thing, Things)
    ).

offered(Word, Thing) :-
    attribute(Thing, Word, true),
    node(Thing, _).
offered(Word, Thing) :-
    setof(Label, Class^( affords_class(Word, Class), subclass(Label, Class) ), Labels),
    member(Label, Labels),
    label(Thing, Label),
    node(Thing, Layer),
    memberchk(Layer, [object, structure]).

offers(Word, Thing, Truth, [test(told, Value, =, nothing, true)]) :-
    attribute(Thing, Word, Value),
    memberchk(Value, [true, false]),
    !,
    Truth = Value.
offers(graspable, Thing, Truth, Tests) :-
    !,
    (   stays(Thing, Class)
    ->  Truth = false,
        Tests = [test(class, Class, =, nothing, movable)]
    ;   hand_opening(Opening),
        narrowest(Thing, Width),
        compared(Width, Opening, Truth),
        Tests = [test(grasp_width, Width, =<, hand_opening, Opening)]
    ).
offers(movable, Thing, Truth, [test(class, Label, =, nothing, movable)]) :-
    !,
    label(Thing, Label),
    ( stays(Thing, _) -> Truth = false ; Truth = true ).
offers(Word, Thing, Truth, [test(class, Label, =, nothing, Word)]) :-
    label(Thing, Label),
    (   subclass(Label, Class),
        affords_class(Word, Class)
    ->  Truth = true
    ;   class_known(Label)
    ->  Truth = false
    ;   Truth = unknown
    ).

%   class_known(+Label): the taxonomy says what kind of thing Label is; of others nobody knows what they offer.
class_known(Label) :-
    once(( subclass(Label, Super), Super \== Label )),
    !.
class_known(Label) :-
    once(( subclass(Below, Label), Below \== Label )).

stays(Thing, Class) :-
    node(Thing, structure),
    !,
    Class = structure.
stays(Thing, Class) :-
    label(Thing, Label),
    subclass(Label, Class),
    immovable(Class),
    !.

narrowest(Thing, Width) :-
    size(Thing, X, Y, Z),
    !,
    Width is min(X, min(Y, Z)).
narrowest(_, unknown).

compared(unknown, _, Truth) :- !, Truth = unknown.
compared(_, unknown, Truth) :- !, Truth = unknown.
compared(Value, Most, Truth) :- Value =< Most, !, Truth = true.
compared(_, _, false).

hand_opening(Opening) :-
    asking(Robot),
    attribute(Robot, hand_opening_m, Opening),
    number(Opening),
    !.
hand_opening(Opening) :-
    assumed(hand_opening, Opening, _, _).

                /*******************************
                *     WHAT THE ROBOT CAN DO    *
                *******************************/

%!  capability(?Word) is nondet.

capability(can_reach).
capability(can_carry).
capability(fits_through).

%!  can(?Word, ?Thing, -Truth, -Tests:list) is nondet.
%
%   Truth: the robot that asks can do Word with Thing: `can_reach` it from where
%   it can get to, `can_carry` it (it is light enough and no fixture), or
%   `fits_through` it, a door or opening.

can(can_reach, Thing, Truth, Tests) :-
    asking(Robot),
    judged(reachable, Thing, Robot, Truth, Tests).
can(can_carry, Thing, Truth, Tests) :-
    node(Thing, object),
    (   stays(Thing, Class)
    ->  Truth = false,
        Tests = [test(class, Class, =, nothing, movable)]
    ;   payload(Payload),
        weight_range(Thing, Least, Most),
        Tests = [test(weight, Weight, =<, payload, Payload)],
        (   Most \== unknown, Most =< Payload
        ->  Truth = true, Weight = Most
        ;   Least \== unknown, Least > Payload
        ->  Truth = false, Weight = Least
        ;   Truth = unknown, Weight = unknown
        )
    ).
can(fits_through, Door, Truth, [test(clear_width, Width, >, robot_width, Needed)]) :-
    ( asking(Robot) -> true ; Robot = none ),
    robot_width(Robot, Needed),
    passage(Door, Width),
    (   number(Width)
    ->  ( Width > Needed -> Truth = true ; Truth = false )
    ;   Truth = unknown
    ).

%!  asking(-Robot) is semidet.
%
%   The robot that asks; when none does, the only one there is.

asking(Robot) :-
    viewer(Viewer),
    atom(Viewer),
    Viewer \== none,
    !,
    Robot = Viewer.
asking(Robot) :-
    findall(Id, node(Id, agent), [Robot]).

payload(Payload) :-
    asking(Robot),
    attribute(Robot, payload_kg, Payload),
    number(Payload),
    !.
payload(Payload) :-
    assumed(payload, Payload, _, _).

%   passage(?Door, -Width): each door or opening between rooms, once, and how wide it is [m], or unknown.
passage(Door, Width) :-
    (   nonvar(Door)
    ->  true
    ;   setof(D, R^V^T^C^edge(connects, D, R, V, T, C), Doors),
        member(Door, Doors)
    ),
    findall(W, edge(connects, Door, _, W, _, _), Widths),
    Widths = [First|_],
    ( number(First) -> max_list(Widths, Width) ; Width = unknown ).

%   weight_range(+Thing, -Least, -Most): in kilograms, as told or as is typical of its class.
weight_range(Thing, Weight, Weight) :-
    attribute(Thing, weight_kg, Weight),
    number(Weight),
    !.
weight_range(Thing, Least, Most) :-
    label(Thing, Label),
    subclass(Label, Class),
    typical_weight(Class, Least, Most),
    !.
weight_range(_, unknown, unknown).

%!  typical_weight(?Class, -Least, -Most) is nondet.
%
%   Things of Class, or of a class below it that is not named here itself, weigh
%   between Least and Most kilograms, filled as they are used.

typical_weight(glass, 0.1, 0.7).            typical_weight(cup, 0.1, 0.8).
typical_weight(cutlery, 0.01, 0.3).         typical_weight(plate, 0.1, 1.2).
typical_weight(bowl, 0.1, 2.5).             typical_weight(jug, 0.3, 3.0).
typical_weight(tray, 0.2, 2.0).             typical_weight(bottle, 0.05, 2.0).
typical_weight(can, 0.02, 1.0).             typical_weight(jar, 0.1, 1.5).
typical_weight(pot, 0.4, 6.0).              typical_weight(pan, 0.4, 4.0).
typical_weight(cutting_board, 0.2, 2.5).    typical_weight(kettle, 0.6, 3.0).
typical_weight(toaster, 0.8, 3.0).          typical_weight(microwave, 9.0, 20.0).
typical_weight(coffee_machine, 1.2, 15.0).  typical_weight(iron, 0.8, 2.5).
typical_weight(vacuum_cleaner, 2.0, 9.0).   typical_weight(fruit, 0.02, 1.5).
typical_weight(vegetable, 0.02, 2.0).       typical_weight(bread, 0.05, 1.5).
typical_weight(milk, 0.2, 1.6).             typical_weight(cereal, 0.1, 1.2).
typical_weight(book, 0.1, 2.5).             typical_weight(magazine, 0.05, 0.7).
typical_weight(paper, 0.005, 1.0).          typical_weight(pen, 0.005, 0.1).
typical_weight(phone, 0.1, 0.4).            typical_weight(remote_control, 0.05, 0.3).
typical_weight(mouse, 0.05, 0.3).           typical_weight(keyboard, 0.3, 2.0).
typical_weight(laptop, 0.8, 3.0).           typical_weight(monitor, 2.0, 12.0).
typical_weight(tv, 5.0, 60.0).              typical_weight(printer, 3.5, 30.0).
typical_weight(speaker, 0.2, 25.0).         typical_weight(computer, 0.5, 20.0).
typical_weight(camera, 0.1, 2.0).           typical_weight(router, 0.1, 1.0).
typical_weight(pillow, 0.2, 2.0).           typical_weight(blanket, 0.5, 5.0).
typical_weight(towel, 0.1, 1.0).            typical_weight(rug, 0.5, 40.0).
typical_weight(shoe, 0.1, 1.5).             typical_weight(jacket, 0.3, 3.0).
typical_weight(teddy_bear, 0.1, 2.0).       typical_weight(toy_block, 0.005, 0.3).
typical_weight(ball, 0.02, 1.5).            typical_weight(umbrella, 0.2, 1.2).
typical_weight(soap, 0.05, 0.6).            typical_weight(toothbrush, 0.01, 0.3).
typical_weight(toilet_paper, 0.05, 0.3).    typical_weight(scissors, 0.02, 0.4).
typical_weight(key, 0.005, 0.1).            typical_weight(candle, 0.05, 2.0).
typical_weight(clock, 0.1, 5.0).            typical_weight(picture, 0.2, 15.0).
typical_weight(vase, 0.2, 5.0).             typical_weight(chair, 2.5, 20.0).
typical_weight(stool, 1.5, 10.0).           typical_weight(armchair, 12.0, 50.0).
typical_weight(table, 5.0, 80.0).           typical_weight(desk, 10.0, 80.0).
typical_weight(bicycle, 7.0, 30.0).
