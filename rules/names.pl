:- module(names,
          [ most_alike/3,                  % +Name, +Candidates, -Nearest
            name_atom/2,                % +Name, ?Atom
            unknown_name/2,             % +Atom, +Names
            did_you_mean/2,             % +Names, -Hint
            known_key/1,                % ?Key
            known_value/1               % ?Value
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(isub)).
:- use_module(facts).
:- use_module(rooms).

/** <module> Which names are known, and which are nearest to one that is not */

%!  known_key(?Key) is nondet.
%
%   Key can be asked about as an attribute.

known_key(Key) :- attribute(_, Key, _).
known_key(color).
known_key(colour).
known_key(material).
known_key(state).
known_key(type).
known_key(front).

%!  known_value(?Value) is nondet.
%
%   Value can be asked for as the value of an attribute.

known_value(Value) :- attribute(_, _, Value), atom(Value).
known_value(Value) :- type_of_room(Value).
known_value(Value) :-
    member(Value, [ red, green, blue, yellow, orange, brown, black, white, grey, gray, pink, purple, beige,
                    open, closed, true, false, wood, metal, glass, plastic, fabric, stone, ceramic, paper ]).

%!  unknown_name(+Atom, +Names:list(atom)) is failure.
%
%   @error problem(unknown_name, ...) with the nearest of Names

unknown_name(Atom, Names) :-
    most_alike(Atom, Names, Nearest),
    format(string(Message), "~q is neither an id, a class, a name nor a value that is known", [Atom]),
    did_you_mean(Nearest, Hint),
    throw(problem(unknown_name, Message, Hint)).

%!  did_you_mean(+Names:list(atom), -Hint:string) is det.

did_you_mean([], "") :- !.
did_you_mean(Names, Hint) :-
    maplist(in_backquotes, Names, Quoted),
    atomic_list_concat(Quoted, ', ', List),
    format(string(Hint), "did you mean ~w?", [List]).

in_backquotes(Name, Quoted) :-
    format(atom(Quoted), "`~w`", [Name]).

%!  most_alike(+Name:atom, +Candidates:list(atom), -Nearest:list(atom)) is det.
%
%   The up to three Candidates that are spelled most like Name, best first.

most_alike(Name, Candidates, Nearest) :-
    sort(Candidates, Unique),
    findall(Likeness-Candidate,
            ( member(Candidate, Unique),
              likeness(Name, Candidate, Likeness) ),
            Scored),
    sort(1, @>=, Scored, Sorted),
    findall(C, ( nth1(I, Sorted, _-C), I =< 3 ), Nearest).

likeness(Name, Candidate, 1) :-
    one_edit(Name, Candidate),
    !.
likeness(Name, Candidate, Likeness) :-
    isub(Name, Candidate, Likeness, [normalize(true), zero_to_one(true)]),
    Likeness > 0.6.

%   one_edit(+A, +B): a letter is missing, too many, another, or two are exchanged.
one_edit(A, B) :-
    atom_length(A, LA),
    atom_length(B, LB),
    abs(LA-LB) =< 1,
    atom_codes(A, As),
    atom_codes(B, Bs),
    same_start(As, Bs, RestA, RestB),
    (   RestA = [_|Same], RestB = [_|Same]
    ;   RestA = [_|RestB]
    ;   RestB = [_|RestA]
    ;   RestA = [X,Y|Same], RestB = [Y,X|Same]
    ),
    !.

same_start([X|As], [X|Bs], RestA, RestB) :-
    !,
    same_start(As, Bs, RestA, RestB).
same_start(As, Bs, As, Bs).

%!  name_atom(+Name, ?Atom) is semidet.
%
%   Atom stands for the Name of a thing, 'guest room' and guest_room alike.

name_atom(Name, Atom) :-
    atom_string(Spelled, Name),
    (   Atom = Spelled
    ;   string_lower(Name, Lower),
        split_string(Lower, " -", " -", Words),
        atomic_list_concat(Words, '_', Atom)
    ),
    !.
