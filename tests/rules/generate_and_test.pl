%   The reference: every assignment of possible labels, the consistent ones
%   weighed (Nüchter & Hertzberg 2008, section 3.1, without their order).
%   What cannot be completed is not tried further.

%!  least_cost(+Planes, +Relations, -Least) is semidet.

least_cost(Planes, Relations, Least) :-
    aggregate_all(min(Cost),
                  ( assignment(Planes, Relations, [], [], Labels),
                    structure:labelling_cost(Planes, Relations, Labels, Cost)
                  ),
                  Least).

assignment([], _, _, Labels, Labels).
assignment([Plane|Planes], Relations, Done0, Labels0, Labels) :-
    structure:label_cost(Plane, Label, _),
    arg(1, Plane, Id),
    Labels1 = [Id-Label|Labels0],
    Done = [Plane|Done0],
    include(between(Done), Relations, Here),
    forall(member(Relation, Here), goes_with(Relation, Done, Labels1)),
    assignment(Planes, Relations, Done, Labels1, Labels).

between(Done, relation(_, A, B)) :-
    memberchk(plane(A, _, _, _, _, _, _), Done),
    memberchk(plane(B, _, _, _, _, _, _), Done).

goes_with(relation(Name, A, B), Done, Labels) :-
    structure:plane_and_label(A, Done, Labels, PlaneA, LabelA),
    structure:plane_and_label(B, Done, Labels, PlaneB, LabelB),
    structure:allowed(Name, PlaneA, LabelA, PlaneB, LabelB).
