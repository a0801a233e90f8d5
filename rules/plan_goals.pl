:- module(plan_goals,
          [ plan_goal/2                 % +Text, -Reading
          ]).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(solution_sequences)).
:- use_module(facts).
:- use_module(vocabulary).
:- use_module(goals).
:- use_module(readings).
:- use_module(ask, [problem_of/2]).

/** <module> From the text of a goal to what a planner shall bring about

A goal is written as a question is, and checked as one. Its parts are of two
kinds: what actions bring about (on, in, near, holding, open, ...), which becomes
a wish; and what they cannot change (a class, a colour, which room), which says
what the goal is about, and is answered here, now.
*/

most_answers(5_000).

%!  plan_goal(+Text:string, -Reading) is det.
%
%   Reading is goal(Wishes, Domains, Contexts), or problem(Code, Message, Hint).
%
%     * Wishes: wish(Sign, Term); Sign is yes, or no for what shall not hold.
%       In Term stand ids, and v(N) for something that is to be chosen.
%     * Domains: domain(v(N), Class, Ids): a class name that stood there, and its instances
%     * Contexts: context(Text, [v(N), ...], Rows): what else was said of them, and for whom it holds

plan_goal(Text, Reading) :-
    catch(( read_goal(Text, Goal, _, _),
            parts(Goal, Wishes, [], Others, []),
            wanted(Wishes),
            domains(Wishes, Domains),
            maplist(context, Others, Contexts),
            Reading = goal(Plain, Domains, Contexts),
            maplist(plain, Wishes, Plain),
            term_variables(Reading, Variables),
            foldl(number, Variables, 0, _) ),
          Error,
          problem_of(Error, Reading)).

wanted([_|_]) :- !.
wanted([]) :-
    throw(problem(not_a_plan_goal, "nothing in this goal can be brought about by an action",
                  "say, for example, on(cup, table), in(milk, fridge), holding(cup), open(fridge) or near(robot, oven)")).

%   parts(+Goal, -Wishes, ?Rest, -Others, ?Rest): wishes are wish(Sign, Call, Hidden).
parts(and(A, B), W0, W, O0, O) :- !,
    parts(A, W0, W1, O0, O1),
    parts(B, W1, W, O1, O).
parts(literal(Call, Hidden, _), [wish(yes, Call, Hidden)|W], W, O, O) :-
    brought_about(Call),
    !.
parts(not(literal(Call, Hidden, _)), [wish(no, Call, Hidden)|W], W, O, O) :-
    brought_about(Call),
    !.
parts(all(If, Then), W0, W, O, O) :- !,
    each(If, Then, Goals),
    foldl(part_of_each, Goals, W0, W).
parts(Goal, W, W, [Goal|O], O) :-
    asks_only(Goal),
    !.
parts(_, _, _, _, _) :-
    throw(problem(not_a_plan_goal, "a planner is given a conjunction: alternatives, aggregates and `if` are not for it",
                  "say what shall hold: on(cup, table), \\+ on(book, bed), forall(cup(X), on(X, table))")).

part_of_each(Goal, W0, W) :-
    parts(Goal, W0, W, Others, []),
    (   Others == []
    ->  true
    ;   throw(problem(not_a_plan_goal, "after forall(..., stands what shall hold of each, and nothing else",
                      "forall(cup(X), on(X, table))"))
    ).

%   each(+If, +Then, -Goals): Then, for all that If is known to hold of.
each(If, Then, Goals) :-
    readings(If, Certain, _),
    most_answers(Most),
    findall(Then, limit(Most, Certain), Goals).

%   brought_about(+Call): some action can make it true.
brought_about(on(_, _)).                brought_about(supports(_, _)).
brought_about(in(_, _)).                brought_about(contains(_, _)).
brought_about(near(_, _)).
brought_about(holding(_)).              brought_about(holding(_, _)).
brought_about(open(_)).                 brought_about(closed(_)).
brought_about(switched_on(_)).          brought_about(switched_off(_)).
brought_about(poured(_, _)).

asks_only(literal(_, _, _)).
asks_only(plain(_)).
asks_only(not(Goal)) :- asks_only(Goal).

%   domains(+Wishes, -Domains): the class names that stand in wishes, each with its instances.
domains(Wishes, Domains) :-
    maplist(wish_hidden, Wishes, Lists),
    append(Lists, Pairs),
    maplist(domain, Pairs, Domains).

wish_hidden(wish(_, _, Hidden), Hidden).

domain(Variable-Class, domain(Variable, Class, Ids)) :-
    findall(Id, instance_of(Id, Class), Found),
    sort(Found, Ids).

%   context(+Goal, -Context): for whom a condition is known to hold.
context(Goal, context(Text, Variables, Rows)) :-
    readings(Goal, Certain, _),
    visible_variables(Goal, Variables),
    most_answers(Most),
    findall(Variables, limit(Most, Certain), Found),
    sort(Found, Rows),
    condition_text(Goal, Text).

condition_text(literal(Call, Hidden, _), Text) :- !,
    copy_term(Call-Hidden, Shown-Classes),
    maplist(put_class, Classes),
    shown(Shown, Text).
condition_text(not(Goal), Text) :- !,
    condition_text(Goal, Inner),
    string_concat("not ", Inner, Text).
condition_text(plain(Call), Text) :-
    copy_term(Call, Shown),
    shown(Shown, Text).

put_class(Class-Class).

shown(Term, Text) :-
    numbervars(Term, 23, _),
    format(string(Text), "~W", [Term, [numbervars(true), quoted(true), spacing(next_argument)]]).

plain(wish(Sign, Call, _), wish(Sign, Call)).

number(v(N), N, Next) :- Next is N+1.
