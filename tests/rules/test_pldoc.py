"""The rules' documentation is made by pldoc without a warning, and tells of every predicate that a module exports."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from rules import rule_path

DOCUMENT = """
:- use_module(library(pldoc)).
:- use_module(library(doc_files)).
:- use_module(library(pldoc/doc_process)).
:- doc_collect(true).

document(Rules, Output) :-
    atom_concat(Rules, '/*.pl', Pattern),
    expand_file_name(Pattern, Files),
    load_files(Files, [silent(true)]),
    doc_save(Rules, [doc_root(Output), format(html), recursive(false), if(true)]),
    forall(( member(File, Files), module_property(Module, file(File)), module_property(Module, exports(Exports)),
             member(Name/Arity, Exports), \\+ documented(Module, Name/Arity) ),
           format("~w: ~w/~w~n", [Module, Name, Arity])).

documented(Module, Predicate) :- doc_comment(Module:Predicate, _, _, _).
documented(Module, Name/Arity) :- Short is Arity-2, doc_comment(Module:Name//Short, _, _, _).
documented(vocabulary, Name/Arity) :- functor(Head, Name, Arity), vocabulary:signature(Head, _).
documented(Module, Predicate) :-
    Predicate = Name/Arity,
    functor(Head, Name, Arity),
    predicate_property(Module:Head, imported_from(_)).
"""


def test_pldoc_has_nothing_to_complain_of(tmp_path: Path) -> None:
    swipl = shutil.which("swipl")
    assert swipl, "SWI-Prolog is not installed"
    program = tmp_path / "document.pl"
    program.write_text(DOCUMENT)
    goal = f"document('{rule_path()}', '{tmp_path}')"
    command = [swipl, "-q", "--on-warning=status", "--on-error=status", "-g", goal, "-t", "halt", str(program)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    assert run.stdout == "", f"exported without documentation: {run.stdout}"
    pages = {page.stem for page in tmp_path.rglob("*.html")}
    assert pages >= {rule.stem for rule in rule_path().glob("*.pl")}
