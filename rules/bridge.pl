:- module(bridge, [ serve/3 ]).         % +Command, +Payload, -Reply

/** <module> The one door between the service and the rule base

A command comes in as the text of a term with a text payload, and one JSON text
goes out. Every Prolog term has exactly one JSON form (see reasoning/terms.py):
an atom is a JSON string, a string is {"s": ...}, a compound is an array that
begins with its name, a list is {"l": [...]}, a variable is {"v": ...}.
*/

:- use_foreign_library(foreign(json)).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(time)).
:- use_module(facts, [update/1, new_revision/0]).
:- use_module(ask).
:- use_module(watching).
:- use_module(language).
:- use_module(told_rules).
:- dynamic load_message/1.

%!  serve(+Command:string, +Payload:string, -Reply:string) is det.
%
%   Carry out Command and describe the result in Reply, as JSON. Never raises:
%   what goes wrong is itself a reply, problem(Code, Message, Hint).

serve(Command, Payload, Reply) :-
    catch(( term_string(Term, Command),
            once(run(Term, Payload, Result))
          ),
          Error,
          problem_of(Error, Result)),
    !,
    catch(reply_text(Result, Reply),
          Error2,
          ( problem_of(Error2, Problem), reply_text(Problem, Reply) )).
serve(Command, _, Reply) :-
    reply_text(problem(engine_error, Command, ""), Reply).

run(ping, _, pong).
run(load(Ours, Users), _, loaded) :-
    maplist(load_strictly(trusted), Ours),
    user_rules:use_module(library(lists)),
    forall(member(Module, [facts, taxonomy, spatial, rooms, viewpoint, vocabulary]),
           ( module_property(Module, file(File)), user_rules:use_module(File) )),
    maplist(load_strictly(user_rules), Users).
run(update, Payload, updated) :-
    setup_call_cleanup(open_string(Payload, Stream),
                       update(Stream),
                       close(Stream)).
run(ask(Options), Payload, Reply) :-
    ask(Payload, Options, Reply).
run(watch(Watches, Seconds), _, Replies) :-
    ask_noting(Watches, Seconds, Replies).
run(call(Limit, Seconds), Payload, Reply) :-
    call_trusted(Payload, Limit, Seconds, Reply).
run(learn(Rules, Names), Payload, learned(Words)) :-
    learn(Rules, Payload, Names, Words),
    new_revision.
run(unlearn(Rules), _, unlearned) :-
    unlearn(Rules),
    new_revision.
run(phrase, Payload, Reply) :-
    understand(Payload, Reply).

reply_text(Term, Text) :-
    with_output_to(string(Text), json(Term, 0)).

%   json(+Term, +Depth): the one JSON form of Term on current output.

json(Term, _) :-
    var(Term), !,
    format("{\"v\":\"~w\"}", [Term]).
json([], _) :- !,
    write('{"l":[]}').
json(Term, _) :-
    atom(Term), !,
    json_write_string(current_output, Term).
json(Term, _) :-
    number(Term), !,
    json_number(Term).
json(Term, _) :-
    string(Term), !,
    write('{"s":'),
    json_write_string(current_output, Term),
    put_char('}').
json(_, Depth) :-
    Depth > 200, !,
    throw(problem(resource_limit, "a term in the answer is nested more than 200 deep", "")).
json(List, Depth) :-
    is_list(List), !,
    List = [First|Rest],
    Next is Depth+1,
    write('{"l":['),
    json(First, Next),
    json_rest(Rest, Next),
    write(']}').
json(Term, Depth) :-
    compound(Term), !,
    compound_name_arguments(Term, Name, Arguments),
    Next is Depth+1,
    put_char('['),
    json_write_string(current_output, Name),
    json_rest(Arguments, Next),
    put_char(']').
json(Term, _) :-
    format(string(Text), "~q", [Term]),
    throw(problem(resource_limit, "an answer holds something that is not a term", Text)).

json_rest([], _).
json_rest([Term|Terms], Depth) :-
    put_char(','),
    json(Term, Depth),
    json_rest(Terms, Depth).

json_number(Number) :-
    integer(Number), !,
    (   Number =\= 0,
        msb(abs(Number)) > 100_000
    ->  throw(problem(resource_limit, "an answer holds a number of more than 30 000 digits", ""))
    ;   -9223372036854775808 =< Number, Number < 9223372036854775808
    ->  write(Number)
    ;   format("{\"i\":\"~16r\"}", [Number])
    ).
json_number(Number) :-
    float(Number), !,
    (   Number =:= inf
    ->  write('{"f":"inf"}')
    ;   Number =:= -inf
    ->  write('{"f":"-inf"}')
    ;   Number =\= Number
    ->  write('{"f":"nan"}')
    ;   write(Number)
    ).
json_number(Number) :-
    Numerator is numerator(Number),
    Denominator is denominator(Number),
    format("{\"q\":\"~d/~d\"}", [Numerator, Denominator]).

%   load_strictly(+Module, +File): load rules into Module; any warning or error refuses them.

load_strictly(Module, File) :-
    retractall(load_message(_)),
    setup_call_cleanup(
        asserta((user:message_hook(Term, Kind, _) :- bridge:strict(Kind, Term)), Hook),
        load_rules(Module, File),
        erase(Hook)),
    (   load_message(Message)
    ->  throw(problem(invalid_rules, Message, ""))
    ;   true
    ).

%!  strict(+Kind, +Term) is semidet.
%
%   While rules are loaded: keep what would be printed as a warning or an error.

strict(Kind, Term) :-
    memberchk(Kind, [warning, error]),
    describe(Term, Text),
    (   source_location(File, Line)
    ->  format(string(Message), "~w:~w: ~w", [File, Line, Text])
    ;   Message = Text
    ),
    assertz(load_message(Message)).

load_rules(Module, File) :-
    catch(Module:load_files(File, [if(not_loaded), silent(true)]),
          Error,
          ( describe(Error, Message), assertz(load_message(Message)) )).

describe(Term, Text) :-
    catch(( message_to_codes_text(Term, Text0), Text = Text0 ), _, term_string(Term, Text)).

message_to_codes_text(Term, Text) :-
    phrase(prolog:translate_message(Term), Lines),
    with_output_to(string(Padded), print_message_lines(current_output, '', Lines)),
    split_string(Padded, "\n", " \t", Parts),
    exclude(==(""), Parts, Kept),
    atomic_list_concat(Kept, ' ', Atom),
    atom_string(Atom, Text).
