:- module(taxonomy,
          [ kind_of/2,                  % ?Class, ?Kind
            subclass/2,                 % ?Class, ?Super
            class/1,                    % ?Class
            labelled/2,                 % ?Id, ?Class
            container_class/1,          % ?Class
            holds_things/1,             % ?Class
            part_kind/2                 % ?Part, ?Whole
          ]).
:- use_module(facts).

/** <module> What kinds of things there are in a home

A class is its label in lower snake case. kind_of/2 is the tree below; a label
space may extend it with its own parents, class_info(Class, Kind, Parent), and an
operator with told(subclass(Class, Parent)). There
is no list of allowed labels: a label that is not named here is a class all the
same, without a kind.

    ?- subclass(armchair, furniture).
    true.
*/

%!  kind_of(?Class, ?Kind) is nondet.
%
%   Kind is a direct parent of Class, here, in a label space, or as an operator
%   told with subclass(Class, Kind), of which there may be several.

kind_of(Class, Kind) :-
    kind(Class, Kind).
kind_of(Class, Kind) :-
    class_info(Class, _, Kind),
    Kind \== none,
    \+ kind(Class, Kind).
kind_of(Class, Kind) :-
    told(subclass(Class, Kind)),
    \+ kind(Class, Kind),
    \+ class_info(Class, _, Kind).

% The fabric of a building
kind(wall, building_element).           kind(floor, building_element).
kind(ceiling, building_element).        kind(door, building_element).
kind(window, building_element).         kind(stairs, building_element).
kind(pillar, building_element).         kind(radiator, building_element).
kind(opening, building_element).        kind(door_frame, building_element).

kind(building_element, structure).

% Furniture
kind(seat, furniture).                  kind(surface, furniture).
kind(storage, furniture).               kind(bed, furniture).
kind(chair, seat).                      kind(stool, seat).
kind(bench, seat).                      kind(sofa, seat).
kind(armchair, seat).                   kind(office_chair, chair).
kind(dining_chair, chair).              kind(couch, sofa).
kind(ottoman, seat).
kind(table, surface).                   kind(desk, surface).
kind(counter, surface).                 kind(coffee_table, table).
kind(dining_table, table).              kind(side_table, table).
kind(kitchen_counter, counter).         kind(workbench, surface).
kind(nightstand, surface).              kind(tv_stand, surface).
kind(shelf, storage).                   kind(cabinet, storage).
kind(wardrobe, storage).                kind(drawer, storage).
kind(chest_of_drawers, storage).        kind(dresser, storage).
kind(bookcase, shelf).                  kind(bookshelf, shelf).
kind(cupboard, cabinet).                kind(kitchen_cabinet, cabinet).
kind(shoe_rack, storage).               kind(coat_rack, furniture).
kind(crib, bed).                        kind(bunk_bed, bed).

% Appliances and electronics
kind(oven, appliance).                  kind(stove, appliance).
kind(fridge, appliance).                kind(refrigerator, fridge).
kind(freezer, appliance).               kind(dishwasher, appliance).
kind(microwave, appliance).             kind(toaster, appliance).
kind(kettle, appliance).                kind(coffee_machine, appliance).
kind(washing_machine, appliance).       kind(dryer, appliance).
kind(extractor_hood, appliance).        kind(vacuum_cleaner, appliance).
kind(iron, appliance).                  kind(fan, appliance).
kind(electronics, artefact).            kind(appliance, artefact).
kind(tv, electronics).                  kind(monitor, electronics).
kind(laptop, electronics).              kind(computer, electronics).
kind(keyboard, electronics).            kind(mouse, electronics).
kind(printer, electronics).             kind(phone, electronics).
kind(speaker, electronics).             kind(remote_control, electronics).
kind(camera, electronics).              kind(router, electronics).

% Lamps
kind(lamp, light).                      kind(floor_lamp, lamp).
kind(table_lamp, lamp).                 kind(ceiling_lamp, lamp).
kind(desk_lamp, lamp).                  kind(light, artefact).

% Sanitary
kind(sink, sanitary).                   kind(toilet, sanitary).
kind(bathtub, sanitary).                kind(shower, sanitary).
kind(washbasin, sink).                  kind(sanitary, artefact).

% Kitchenware
kind(tableware, artefact).              kind(cookware, artefact).
kind(cup, tableware).                   kind(mug, cup).
kind(glass, tableware).                 kind(wine_glass, glass).
kind(bowl, tableware).                  kind(plate, tableware).
kind(jug, tableware).                   kind(fork, cutlery).
kind(knife, cutlery).                   kind(spoon, cutlery).
kind(cutlery, tableware).               kind(tray, tableware).
kind(bottle, vessel).                   kind(can, vessel).
kind(jar, vessel).                      kind(vessel, artefact).
kind(pot, cookware).                    kind(pan, cookware).
kind(cutting_board, cookware).

% Receptacles
kind(bin, receptacle).                  kind(trash_can, bin).
kind(basket, receptacle).               kind(box, receptacle).
kind(laundry_basket, basket).           kind(bag, receptacle).
kind(backpack, bag).                    kind(suitcase, bag).
kind(vase, receptacle).                 kind(flowerpot, receptacle).
kind(bucket, receptacle).               kind(receptacle, artefact).

% Food
kind(fruit, food).                      kind(vegetable, food).
kind(apple, fruit).                     kind(banana, fruit).
kind(orange, fruit).                    kind(bread, food).
kind(milk, food).                       kind(cereal, food).
kind(cheese, food).                     kind(egg, food).
kind(carrot, vegetable).                kind(tomato, vegetable).
kind(potato, vegetable).

% Textiles
kind(rug, textile).                     kind(carpet, rug).
kind(pillow, textile).                  kind(cushion, pillow).
kind(blanket, textile).                 kind(towel, textile).
kind(curtain, textile).                 kind(mattress, textile).
kind(clothes, textile).                 kind(shoe, clothes).
kind(jacket, clothes).                  kind(textile, artefact).

% Things about the house
kind(book, artefact).                   kind(magazine, artefact).
kind(paper, artefact).                  kind(pen, artefact).
kind(picture, decoration).              kind(mirror, decoration).
kind(clock, decoration).                kind(candle, decoration).
kind(statue, decoration).               kind(decoration, artefact).
kind(plant, living_thing).              kind(person, living_thing).
kind(cat, living_thing).                kind(dog, living_thing).
kind(toy, artefact).                    kind(ball, toy).
kind(teddy_bear, toy).                  kind(toy_block, toy).                  kind(umbrella, artefact).
kind(soap, artefact).                   kind(toothbrush, artefact).
kind(toilet_paper, artefact).           kind(bicycle, artefact).
kind(piano, artefact).                  kind(guitar, artefact).
kind(scissors, artefact).               kind(key, artefact).
kind(furniture, artefact).

%!  subclass(?Class, ?Super) is nondet.
%
%   Super is Class or an ancestor of it. With an unbound Class, every known
%   class below Super. A circle among a label space's parents ends where it
%   closes.

subclass(Class, Super) :-
    nonvar(Class),
    !,
    up(Class, [], Super).
subclass(Class, Super) :-
    nonvar(Super),
    !,
    down(Super, [], Class).
subclass(Class, Super) :-
    setof(C, class(C), Classes),
    member(Class, Classes),
    up(Class, [], Super).

up(Class, _, Class).
up(Class, Seen, Super) :-
    kind_of(Class, Kind),
    Kind \== Class,
    \+ memberchk(Kind, Seen),
    up(Kind, [Class|Seen], Super).

down(Super, _, Super).
down(Super, Seen, Class) :-
    kind_of(Below, Super),
    Below \== Super,
    \+ memberchk(Below, Seen),
    down(Below, [Super|Seen], Class).

%!  class(?Class) is nondet.
%
%   Class is named here, in a label space, or as a label of some thing.

class(Class) :-
    nonvar(Class),
    !,
    (   kind(Class, _) -> true
    ;   kind(_, Class) -> true
    ;   class_info(Class, _, _) -> true
    ;   class_info(_, _, Class), Class \== none -> true
    ;   told(subclass(Class, _)) -> true
    ;   told(subclass(_, Class)) -> true
    ;   label(_, Class) -> true
    ).
class(Class) :-
    (   kind(Class, _)
    ;   kind(_, Class)
    ;   class_info(Class, _, _)
    ;   class_info(_, _, Class), Class \== none
    ;   told(subclass(Class, _))
    ;   told(subclass(_, Class))
    ;   label(_, Class)
    ).

%!  labelled(?Id, ?Class) is nondet.
%
%   The thing Id carries Class, or a class below it, as its label.

labelled(Id, Class) :-
    nonvar(Id),
    !,
    label(Id, Label),
    subclass(Label, Class).
labelled(Id, Class) :-
    nonvar(Class),
    !,
    subclass(Label, Class),
    label(Id, Label).
labelled(Id, Class) :-
    label(Id, Label),
    subclass(Label, Class).

%!  container_class(?Class) is nondet.
%
%   Things of Class hold others inside: their whole box counts as interior.

container_class(Class) :-
    nonvar(Class),
    !,
    subclass(Class, Super),
    holds_things(Super),
    !.
container_class(Class) :-
    setof(C, S^( holds_things(S), subclass(C, S) ), Classes),
    member(Class, Classes).

%!  holds_things(?Class) is nondet.
%
%   Things of Class and of the classes below it are containers.

holds_things(receptacle).   holds_things(storage).      holds_things(vessel).
holds_things(cup).          holds_things(glass).        holds_things(bowl).
holds_things(jug).          holds_things(pot).          holds_things(pan).
holds_things(kettle).       holds_things(sink).         holds_things(bathtub).
holds_things(oven).         holds_things(fridge).       holds_things(freezer).
holds_things(dishwasher).   holds_things(microwave).    holds_things(washing_machine).
holds_things(dryer).        holds_things(toaster).

%!  part_kind(?Part, ?Whole) is nondet.
%
%   Things of class Part are built into things of class Whole, or a class below
%   it: they are part of the one that they touch.

part_kind(handle, door).            part_kind(handle, window).          part_kind(handle, storage).
part_kind(handle, appliance).       part_kind(door_frame, door).        part_kind(window_frame, window).
part_kind(window_sill, window).     part_kind(drawer, storage).         part_kind(drawer, surface).
part_kind(shelf_board, shelf).      part_kind(cabinet_door, storage).   part_kind(burner, stove).
part_kind(burner, oven).            part_kind(hob, oven).               part_kind(hob, counter).
part_kind(tap, sink).               part_kind(tap, bathtub).            part_kind(faucet, sink).
part_kind(faucet, bathtub).         part_kind(cistern, toilet).
part_kind(toilet_seat, toilet).     part_kind(shower_head, shower).     part_kind(mattress, bed).
part_kind(headboard, bed).          part_kind(backrest, seat).          part_kind(armrest, seat).
part_kind(leg, furniture).          part_kind(lampshade, lamp).         part_kind(lid, receptacle).
part_kind(lid, cookware).           part_kind(wheel, bicycle).
part_kind(socket, wall).            part_kind(light_switch, wall).
