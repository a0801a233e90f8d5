/** <module> Labels for the planes of furniture

More lines of the tables of `rules/structure.pl`: table tops, shelf boards,
cupboard fronts, window panes and stairs' treads are told from what is
`no_feature`. Load it beside the rules that come with the package:

    WorldConfig(rule_files=[rule_path("optional/furniture_planes")])

Each label has a shape, and what must be about it. Whatever else stands about
furniture is no matter, but what is over or under it within its height.
*/

structure:label(table_top, 0.03).
structure:label(shelf_board, 0.04).
structure:label(cupboard_front, 0.05).
structure:label(window, 0.02).
structure:label(tread, 0.02).

% A table top is level, and as high over the floor as people sit or stand at.
structure:shape(table_top, [one_of(facing, [up]), area >= 0.2]).
structure:needs(table_top, above, floor, [a(z_min)-b(z_max) >= 0.3, a(z_min)-b(z_max) =< 1.15]).
structure:supports_label(table, table_top).
structure:supports_label(desk, table_top).
structure:supports_label(coffee_table, table_top).
structure:supports_label(dining_table, table_top).
structure:supports_label(side_table, table_top).
structure:supports_label(counter, table_top).
structure:supports_label(kitchen_counter, table_top).

% A shelf board is as large as another one over or under it.
structure:shape(shelf_board, [one_of(facing, [up, down]), area >= 0.08, area =< 2.0]).
structure:needs(shelf_board, parallel, shelf_board,
                [a(width) =< 1.2*b(width), b(width) =< 1.2*a(width),
                 a(z_min)-b(z_max) =< 0.8, b(z_min)-a(z_max) =< 0.8]).
structure:supports_label(shelf, shelf_board).
structure:supports_label(bookshelf, shelf_board).
structure:supports_label(bookcase, shelf_board).

% A cupboard front is upright, lower than a room, and stands before a wall.
structure:shape(cupboard_front, [one_of(facing, [side]), width >= 0.25, height >= 0.3, height =< 2.35]).
structure:needs(cupboard_front, parallel, wall, [a(area) =< b(area)]).
structure:supports_label(cabinet, cupboard_front).
structure:supports_label(cupboard, cupboard_front).
structure:supports_label(kitchen_cabinet, cupboard_front).
structure:supports_label(wardrobe, cupboard_front).
structure:supports_label(dresser, cupboard_front).
structure:supports_label(chest_of_drawers, cupboard_front).

% Nothing but its class tells a window from the wall about it.
structure:shape(window, [one_of(facing, [side]), width >= 0.25]).
structure:unseen_shape(window, [area =< 0.0]).
structure:supports_label(window, window).

% A tread is a strip with another a step over or under it.
structure:shape(tread, [one_of(facing, [up]), width >= 0.5, area >= 0.08, area =< 0.45*width]).
structure:needs(tread, parallel, tread,
                [max(a(z_min), b(z_min))-min(a(z_min), b(z_min)) >= 0.1,
                 max(a(z_min), b(z_min))-min(a(z_min), b(z_min)) =< 0.25]).
structure:supports_label(stairs, tread).

% What goes with what: only what lies over or under furniture is limited by it.
structure:goes(parallel, Label, _, []) :- furniture_plane(Label).
structure:goes(orthogonal, Label, _, []) :- furniture_plane(Label).
structure:goes(equalheight, Label, _, []) :- furniture_plane(Label).
structure:goes(above, Label, wall, []) :- furniture_plane(Label).
structure:goes(above, Label, door, []) :- furniture_plane(Label).
structure:goes(above, Label, Other, []) :- furniture_plane(Label), furniture_plane(Other).
structure:goes(above, wall, Label, []) :- furniture_plane(Label).
structure:goes(above, door, Label, []) :- furniture_plane(Label).
structure:goes(above, ceiling, Label, [a(z_min)-b(z_max) >= 0.1]) :- furniture_plane(Label).
structure:goes(above, table_top, floor, [a(z_min)-b(z_max) >= 0.3, a(z_min)-b(z_max) =< 1.15]).
structure:goes(above, shelf_board, floor, []).
structure:goes(above, cupboard_front, floor, []).
structure:goes(above, window, floor, []).
structure:goes(above, tread, floor, []).

furniture_plane(table_top).
furniture_plane(shelf_board).
furniture_plane(cupboard_front).
furniture_plane(window).
furniture_plane(tread).
