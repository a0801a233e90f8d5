:- module(lexicon,
          [ noun//4,                    % ?Thing, -Noun, -Number, -Goal
            adjective//2,               % ?Thing, -Goal
            preposition//1,             % -Relation
            superlative//2,             % -How, -Measure
            comparative//2,             % ?Thing, -Comparison
            ability//2,                 % ?Thing, -Goal
            verb//2,                    % ?Number, -Relation
            determiner//2,              % -Quantifier, -Number
            means_room/1,               % +Noun
            word_in_use/1               % ?Word
          ]).
:- use_module(library(lists)).
:- use_module(facts).
:- use_module(rooms).
:- use_module(affordances).
:- use_module(vocabulary).
:- use_module(names).

/** <module> The words of phrases, and what each means in the vocabulary

The nouns are the classes, room types, names and ids of the world at hand; the
adjectives are colours, values of attributes, and what a thing affords. A word
for which another is in use here stands for the other: synonym/2.
*/

                /*******************************
                *            NOUNS             *
                *******************************/

%!  noun(?Thing, -Noun:atom, -Number, -Goal)// is nondet.
%
%   A noun of up to four words for Thing, `singular` or `plural`. A room before a
%   noun tells where it is: "the kitchen table".

noun(Thing, Noun, Number, Goal) -->
    longest_noun(Thing, Noun, Number, Goal).
noun(Thing, Noun, Number, (Goal, in(Thing, Room))) -->
    [Word],
    { noun_class(Word, Room), type_of_room(Room) },
    longest_noun(Thing, Noun, Number, Goal).

longest_noun(Thing, Noun, Number, Goal) -->
    { member(Length, [4, 3, 2, 1]), length(Words, Length) },
    Words,
    { atomic_list_concat(Words, '_', Joined),
      denotes(Joined, Thing, Noun, Number, Goal)
    },
    !.


denotes(Word, Thing, thing, singular, object(Thing)) :-
    memberchk(Word, [thing, object, something, anything]),
    !.
denotes(Word, Thing, thing, plural, object(Thing)) :-
    memberchk(Word, [things, objects, everything]),
    !.
denotes(Word, Thing, Affordance, Number, Goal) :-
    numbered(Word, Affordance, Number),
    memberchk(Affordance, [container, surface]),
    !,
    Goal =.. [Affordance, Thing].
denotes(Word, Thing, Word, singular, Thing = Word) :-
    node(Word, _),
    !.
denotes(Word, Thing, Class, Number, instance_of(Thing, Class)) :-
    numbered(Word, Noun, Number),
    noun_class(Noun, Class),
    !.

numbered(Word, Word, singular).
numbered(Word, Noun, plural) :-
    irregular(Word, Noun).
numbered(Word, Noun, plural) :-
    plural_ending(Ending, Singular),
    atom_concat(Stem, Ending, Word),
    atom_concat(Stem, Singular, Noun).

irregular(people, person).
irregular(mice, mouse).

plural_ending(ies, y).
plural_ending(ves, f).
plural_ending(ves, fe).
plural_ending(es, '').
plural_ending(s, '').

%   noun_class(+Noun, -Class): Class is Noun, or what is in use here for it.
noun_class(Noun, Noun) :-
    instance_of(_, Noun),
    !.
noun_class(Noun, Class) :-
    synonym(Noun, Class),
    instance_of(_, Class),
    !.
noun_class(Noun, Noun) :-
    known_class(Noun),
    !.
noun_class(Noun, Class) :-
    synonym(Noun, Class),
    known_class(Class),
    !.

synonym(A, B) :- same(A, B).
synonym(A, B) :- same(B, A).

same(television, tv).           same(telly, tv).                same(refrigerator, fridge).
same(couch, sofa).              same(settee, sofa).             same(trash_can, bin).
same(garbage_can, bin).         same(waste_basket, bin).        same(bookcase, bookshelf).
same(bookshelf, shelf).         same(bookcase, shelf).          same(stove, oven).
same(cooker, oven).             same(cupboard, cabinet).        same(washbasin, sink).
same(corridor, hallway).        same(hall, hallway).            same(lounge, living_room).
same(sitting_room, living_room).                                same(study, office).
same(tub, bathtub).             same(bath, bathtub).            same(screen, monitor).
same(carpet, rug).              same(robot, agent).             same(night_stand, nightstand).
same(bedside_table, nightstand).                                same(flower, plant).
same(painting, picture).        same(wc, toilet).               same(nursery, child_room).
same(robot_vacuum, robot).      same(cushion, pillow).          same(mug, cup).

%!  means_room(+Noun) is semidet.
%
%   Noun is the room layer, a type of room, or the name or id of a room.

means_room(room) :- !.
means_room(Noun) :-
    type_of_room(Noun),
    !.
means_room(Noun) :-
    node(Noun, room),
    !.
means_room(Noun) :-
    instance_of(Id, Noun),
    !,
    node(Id, room).

%!  determiner(-Quantifier, -Number)// is det.
%
%   Quantifier is `the`, `some`, `all` or `no`; Number what the determiner itself
%   says of the noun's, else unbound. Without one it is some.

determiner(all, _) --> [all], ( [of] ; [] ), ( article(the) ; [] ), !.
determiner(all, _) --> ( [every] ; [each] ), !.
determiner(no, _) --> ( [no] ; [none, of, the] ; [none, of] ; [any, of, no] ), !.
determiner(the, plural) --> ( [these] ; [those] ), !.
determiner(the, _) --> article(the), !.
determiner(some, _) --> ( [a] ; [an] ; [any] ; [some] ), !.
determiner(some, _) --> [].

article(the) --> ( [the] ; [my] ; [our] ; [your] ; [this] ; [that] ), !.

                /*******************************
                *          ADJECTIVES          *
                *******************************/

%!  adjective(?Thing, -Goal)// is nondet.

adjective(Thing, Goal) -->
    [Word],
    { described(Word, Thing, Goal) }.

described(empty, Thing, ( \+ contains(Thing, _), \+ supports(Thing, _) )) :- !.
described(reachable, Thing, can_reach(Thing)) :- !.
described(visible, Thing, ( asker(Robot), visible_from(Thing, Robot) )) :- !.
described(electric, Thing, powered(Thing)) :- !.
described(Word, Thing, Goal) :-
    affordance(Word),
    \+ memberchk(Word, [container, surface]),
    !,
    Goal =.. [Word, Thing].
described(Word, Thing, color(Thing, Color)) :-
    spelled(Word, Color),
    ( attribute(_, color, Color) ; attribute(_, colour, Color) ; hue(Color) ),
    !.
described(Word, Thing, attribute(Thing, _, Word)) :-
    ( attribute(_, _, Word) ; known_value(Word) ),
    \+ type_of_room(Word),
    !.

spelled(Word, Word).
spelled(gray, grey).
spelled(grey, gray).

hue(red).       hue(green).     hue(blue).      hue(yellow).    hue(orange).    hue(brown).     hue(black).
hue(white).     hue(grey).      hue(pink).      hue(purple).    hue(beige).

%!  superlative(-How, -Measure)// is semidet.
%
%   How is `most` or `least` of Measure: extent, height, elevation, width, near, seen.

superlative(most, extent) --> ( [largest] ; [biggest] ), !.
superlative(least, extent) --> [smallest], !.
superlative(most, height) --> [tallest], !.
superlative(least, height) --> [shortest], !.
superlative(most, elevation) --> [highest], !.
superlative(least, elevation) --> [lowest], !.
superlative(most, width) --> [widest], !.
superlative(least, width) --> [narrowest], !.
superlative(least, near) --> ( [nearest] ; [closest] ), !.
superlative(most, near) --> ( [farthest] ; [furthest] ), !.
superlative(most, seen) --> ( [most, recently, seen] ; [last, seen] ; [latest] ; [newest] ), !.
superlative(least, seen) --> ( [least, recently, seen] ; [oldest] ), !.

%!  comparative(?Thing, -Comparison)// is semidet.
%
%   Comparison is than(Other, Goal), of another thing, or measure(Value, Goal) with
%   a comparison sign, of a length.

comparative(Thing, than(Other, larger(Thing, Other))) --> ( [larger] ; [bigger] ), !.
comparative(Thing, than(Other, larger(Other, Thing))) --> [smaller], !.
comparative(Thing, values(height, >, Thing)) --> [taller], !.
comparative(Thing, values(height, <, Thing)) --> [shorter], !.
comparative(Thing, values(width, >, Thing)) --> [wider], !.
comparative(Thing, values(width, <, Thing)) --> [narrower], !.

                /*******************************
                *    VERBS AND PREPOSITIONS    *
                *******************************/

%!  ability(?Thing, -Goal)// is semidet.
%
%   What somebody "can" do with Thing.

ability(Thing, can_reach(Thing)) --> ( [reach] ; [get, to] ), !.
ability(Thing, can_carry(Thing)) --> ( [carry] ; [lift] ; [bring] ), !.
ability(Thing, graspable(Thing)) --> ( [grasp] ; [grip] ; [pick, up] ; [hold] ), !.
ability(Thing, openable(Thing)) --> [open], !.
ability(Thing, sittable(Thing)) --> [sit], ( [on] ; [] ), !.
ability(Thing, surface(Thing)) --> ( [put, things, on] ; [put, something, on] ), !.
ability(Thing, pourable(Thing)) --> [pour, from], !.
ability(Thing, fits_through(Thing)) --> ( [fit, through] ; [pass, through] ; [go, through] ; [pass] ), !.
ability(Thing, ( asker(Robot), visible_from(Thing, Robot) )) --> [see], !.

%!  verb(?Number, -Relation)// is semidet.
%
%   A verb between two things, as it stands after one (`singular`) or several.

verb(singular, contains) --> ( [contains] ; [holds] ), !.
verb(plural, contains) --> ( [contain] ; [hold] ), !.
verb(singular, supports) --> ( [supports] ; [carries] ; [bears] ), !.
verb(plural, supports) --> ( [support] ; [carry] ; [bear] ), !.
verb(singular, touching) --> [touches], !.
verb(plural, touching) --> [touch], !.
verb(singular, blocks) --> [blocks], !.
verb(plural, blocks) --> [block], !.
verb(singular, leads_to) --> [leads, to], !.
verb(plural, leads_to) --> [lead, to], !.
verb(singular, have) --> [has], !.
verb(plural, have) --> [have], !.

%!  preposition(-Relation)// is nondet.

preposition(in_front_of) --> [in, front, of].
preposition(left_of) --> ( [to, the, left, of] ; [on, the, left, of] ; [left, of] ; [the, left, of] ).
preposition(right_of) --> ( [to, the, right, of] ; [on, the, right, of] ; [right, of] ; [the, right, of] ).
preposition(next_to) --> ( [next, to] ; [beside] ).
preposition(on) --> ( [on, top, of] ; [on] ; [upon] ; [standing, on] ; [lying, on] ).
preposition(in) --> ( [inside, of] ; [inside] ; [in] ; [within] ; [into] ).
preposition(under) --> ( [under] ; [below] ; [beneath] ; [underneath] ).
preposition(above) --> ( [above] ; [over] ).
preposition(behind) --> [behind].
preposition(near) --> ( [near, to] ; [near] ; [close, to] ; [by] ; [at] ; [around] ).
preposition(touching) --> [touching].
preposition(adjacent) --> ( [adjacent, to] ; [adjoining] ).
preposition(attached_to) --> ( [attached, to] ; [fixed, to] ; [mounted, on] ).
preposition(hanging_from) --> ( [hanging, from] ; [hanging, off] ).
preposition(part_of) --> ( [part, of] ; [a, part, of] ).
preposition(visible_from) --> [visible, from].
preposition(blocks) --> [blocking].

%!  word_in_use(?Word) is nondet.
%
%   Word has a place in the grammar besides nouns and adjectives.

word_in_use(Word) :-
    memberchk(Word, [ the, a, an, any, some, every, all, each, no, none, my, our, your, this, that, these, those,
                      where, is, are, go, to, find, show, bring, me, what, which, who, and, or, not, between, in, front,
                      of, left, right, next, beside, on, top, upon, inside, within, into, under, below, beneath,
                      underneath, above, over, behind, near, close, by, at, around, touching, attached, fixed, mounted,
                      hanging, from, off, part, visible, blocking, with, without, how, many, far, there, does, do, can,
                      i, last, seen, saw, see, than, color, colour, kind, type, most, least, recently, much, take, look,
                      for, am, looking, please, more, has, have, it, standing, lying, adjacent, adjoining, reachable,
                      somewhere, tell, list, exactly, at, room ]).
word_in_use(Word) :-
    phrase(( superlative(_, _) ; comparative(_, _) ; ability(_, _) ; verb(_, _) ), [Word]).
word_in_use(Word) :-
    memberchk(Word, [ reach, get, carry, lift, bring, grasp, grip, pick, up, hold, open, sit, put, things, pour, fit,
                      pass, through, leads, lead, tall, high, wide, big, large, deep, long, metres, meters, metre,
                      meter, m, cm ]).
