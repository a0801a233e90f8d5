:- module(ask,
          [ ask/3,                      % +Text, +Options, -Reply
            ask_as/4,                   % :Changed, +Text, +Options, -Reply
            call_trusted/4,             % +Text, +Limit, +Seconds, -Reply
            problem_of/2                % +Error, -Problem
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(time)).
:- use_module(facts).
:- use_module(vocabulary).
:- use_module(viewpoint).
:- use_module(goals).
:- use_module(readings).
:- use_module(ordering).
:- use_module(explain).

/** <module> Asking, with limits

A goal is read and checked by goals.pl, compiled by readings.pl into what is
certain and what is possible, and run here under limits of time, inferences and
answers. Whatever goes wrong becomes problem(Code, Message, Hint).
*/

%!  ask(+Text:string, +Options, -Reply) is det.
%
%   Options is options(Limit, Seconds, Inferences, Explain, Viewer). Reply is
%   reply(Truth, Names, Rows, Truncated, Problem, Explanations): the names of the
%   goal's variables, a row of values for each distinct answer, whether there
%   were more than Limit, `none` or a problem, and a list of explanations (empty
%   unless Explain is true).

ask(Text, Options, Reply) :-
    ask_as(=, Text, Options, Reply).

%!  ask_as(:Changed, +Text:string, +Options, -Reply) is det.
%
%   As ask/3, of what call(Changed, Goal, Asked) makes of the checked goal.

:- meta_predicate ask_as(2, +, +, -).

ask_as(Changed, Text, options(Limit, Seconds, Inferences, Explain, Viewer), Reply) :-
    set_viewer(Viewer),
    get_time(Start),
    Deadline is Start+Seconds,
    catch(( read_goal(Text, Read, Bindings, AllNames), call(Changed, Read, Goal) ), Error, true),
    (   nonvar(Error)
    ->  problem_of(Error, Problem),
        Reply = reply(unknown, [], [], false, Problem, [])
    ;   maplist(binding, Bindings, Names, Row),
        well_ordered(Goal, Ordered),
        answers(Ordered, Row, Limit, Deadline, Inferences, Rows, Truncated, Problem),
        truth(Ordered, Rows, Deadline, Inferences, Problem, Truth, LastProblem),
        explanations(Explain, Goal, Bindings-AllNames, Rows, Truth, LastProblem, Deadline, Inferences, Explanations),
        Reply = reply(Truth, Names, Rows, Truncated, LastProblem, Explanations)
    ).

binding(Name=Value, Name, Value).

:- dynamic answer/1.

answers(Goal, Row, Limit, Deadline, Inferences, Rows, Truncated, Problem) :-
    readings(Goal, Certain, _),
    retractall(answer(_)),
    Count = count(0, 0),                % answers, cells in them
    trie_new(Seen),
    limited(collect(Certain, Row, Limit, Seen, Count), Deadline, Inferences, Problem),
    trie_destroy(Seen),
    findall(R, retract(answer(R)), Found),
    (   length(Rows, Limit), append(Rows, [_|_], Found)
    ->  Truncated = true
    ;   Rows = Found,
        Truncated = false
    ).

collect(Goal, Row, _, _, _) :-
    ground(Row),
    !,
    ( call(Goal) -> assertz(answer(Row)) ; true ).
collect(Goal, Row, Limit, Seen, Count) :-
    call(Goal),
    acyclic_term(Row),
    fits_reply(Row, Count),
    trie_insert(Seen, Row),
    assertz(answer(Row)),
    arg(1, Count, Before),
    Now is Before+1,
    nb_setarg(1, Count, Now),
    Now > Limit,
    !.
collect(_, _, _, _, _).

%   All answers together stay within what a reply can carry.
largest_reply(500_000).

fits_reply(Row, Count) :-
    arg(2, Count, Before),
    cells(Row, Before, After),
    nb_setarg(2, Count, After).

%   cells(+Term, +Before, -After): counts what Term has when it is written out, however much of it is shared.
cells(Term, Before, After) :-
    Now is Before+1,
    largest_reply(Most),
    (   Now =< Most
    ->  true
    ;   throw(problem(resource_limit, "the answers are too large for a reply", "ask for less at a time"))
    ),
    (   compound(Term)
    ->  compound_name_arity(Term, _, Arity),
        cells_of_arguments(1, Arity, Term, Now, After)
    ;   string(Term)
    ->  string_length(Term, Length),
        After is Now+Length//8
    ;   After = Now
    ).

cells_of_arguments(Index, Arity, Term, Before, After) :-
    (   Index =< Arity
    ->  arg(Index, Term, Argument),
        (   Index =:= Arity
        ->  cells(Argument, Before, After)
        ;   cells(Argument, Before, Between),
            Next is Index+1,
            cells_of_arguments(Next, Arity, Term, Between, After)
        )
    ;   After = Before
    ).

%   truth(+Goal, +Rows, +Deadline, +Inferences, +Problem, -Truth, -LastProblem)
truth(_, [_|_], _, _, Problem, true, Problem) :- !.
truth(Goal, [], Deadline, Inferences, none, Truth, Problem) :-
    !,
    readings(Goal, _, Possible),
    Found = found(false),
    limited(ignore(( call(Possible), nb_setarg(1, Found, true) )), Deadline, Inferences, Problem),
    (   Problem == none, Found = found(false)
    ->  Truth = false
    ;   Truth = unknown
    ).
truth(_, [], _, _, Problem, unknown, Problem).

explanations(true, Goal, Bindings, Rows, Truth, none, Deadline, Inferences, Explanations) :-
    !,
    Found = found([]),
    limited(( explain(Goal, Bindings, Rows, Truth, List), nb_setarg(1, Found, List) ),
            Deadline, Inferences, _),
    arg(1, Found, Explanations).
explanations(_, _, _, _, _, _, _, _, []).

%   limited(:Goal, +Deadline, +Inferences, -Problem): run Goal, which succeeds, within the limits.
limited(Goal, Deadline, Inferences, Problem) :-
    get_time(Now),
    Left is Deadline-Now,
    (   Left > 0
    ->  catch(( call_with_time_limit(Left, call_with_inference_limit(Goal, Inferences, Outcome)) ->  true ; true ),
              Error,
              true),
        (   nonvar(Error)
        ->  problem_of(Error, Problem)
        ;   Outcome == inference_limit_exceeded
        ->  Problem = problem(resource_limit, "the goal needs more steps than it may take", "ask something narrower")
        ;   Problem = none
        )
    ;   problem_of(time_limit_exceeded, Problem)
    ).

%!  call_trusted(+Text:string, +Limit, +Seconds, -Reply) is det.
%
%   Run a goal of the service's own, unchecked, with every rule module in sight.
%   Reply is answers(Names, Rows) or a problem.

call_trusted(Text, Limit, Seconds, Reply) :-
    term_string(Goal, Text, [module(trusted), variable_names(Bindings)]),
    maplist(binding, Bindings, Names, Row),
    Found = found([]),
    catch(( call_with_time_limit(Seconds, findnsols_once(Limit, Row, trusted:Goal, Rows)),
            nb_setarg(1, Found, Rows) ),
          Error, true),
    (   nonvar(Error)
    ->  problem_of(Error, Reply)
    ;   arg(1, Found, All),
        Reply = answers(Names, All)
    ).

findnsols_once(Limit, Row, Goal, Rows) :-
    findnsols(Limit, Row, Goal, Rows),
    !.

%!  problem_of(+Error, -Problem) is det.
%
%   What is said to a client about an error.

problem_of(problem(Code, Message, Hint), problem(Code, Message, Hint)) :- !.
problem_of(time_limit_exceeded, problem(timeout, "the goal did not end in the time it was given",
                                        "give it more time, or bind more of its variables")) :- !.
problem_of(time_limit_exceeded(_), Problem) :- !,
    problem_of(time_limit_exceeded, Problem).
problem_of(error(resource_error(What), _), problem(resource_limit, Message, "ask something narrower")) :- !,
    format(string(Message), "the goal needs more memory than it may take (~w)", [What]).
problem_of(error(syntax_error(What), Context), problem(syntax_error, Message, "")) :- !,
    syntax_place(Context, Place),
    syntax_words(What, Words),
    format(string(Message), "the goal is not well formed: ~w~w", [Words, Place]).
problem_of(error(type_error(Type, Culprit), _), problem(bad_argument, Message, "")) :- !,
    format(string(Message), "expected ~w, found ~q", [Type, Culprit]).
problem_of(error(instantiation_error, _),
           problem(unbound_variable, "a comparison or sum was reached before its variables had values",
                   "place it after the literals that give them values")) :- !.
problem_of(error(existence_error(matching_rule, _), _), Problem) :- !,
    problem_of(error(instantiation_error, _), Problem).
problem_of(error(evaluation_error(What), _), problem(bad_argument, Message, "")) :- !,
    format(string(Message), "arithmetic: ~w", [What]).
problem_of(error(Formal, _), problem(goal_error, Message, "")) :- !,
    format(string(Message), "~q", [Formal]).
problem_of(Error, problem(goal_error, Message, "")) :-
    format(string(Message), "~q", [Error]).

syntax_place(string(_, Position), Place) :- !,
    First is Position+1,
    format(string(Place), " at character ~d", [First]).
syntax_place(stream(_, Line, LinePosition, _), Place) :- !,
    format(string(Place), " at line ~d, character ~d", [Line, LinePosition]).
syntax_place(_, "").

syntax_words(What, Words) :-
    (   atom(What)
    ->  atomic_list_concat(Parts, '_', What),
        atomic_list_concat(Parts, ' ', Words)
    ;   format(atom(Words), "~w", [What])
    ).
