"""What `scripts/fuzz` feeds to parsers, and that it finds out a parser that does not keep its promises."""

import pytest

from benchmarks.fuzz import __main__ as script
from benchmarks.fuzz import parser as parser_module
from benchmarks.fuzz.parser import Parser, judge
from carrl.errors import CarrlError


@pytest.mark.parametrize("name", script.PARSERS)
def test_only_carrl_errors_come_out_of_a_parser(name, monkeypatch):
    monkeypatch.setattr(parser_module, "SLOW_S", parser_module.HANGING_S)  # how slow this machine is does not matter
    tally = script.fuzz(name, 150, seed=1)
    assert tally.faults == {}
    assert tally.accepted > 5
    assert tally.refused > 50


@pytest.mark.parametrize("name", script.PARSERS)
def test_the_same_seed_makes_the_same_input_and_another_one_another(name, tmp_path):
    contents = []
    for folder, seed in (("a", 3), ("b", 3), ("c", 4)):
        (tmp_path / folder).mkdir()
        parser = script.PARSERS[name](tmp_path / folder)
        parser.make(parser_module.Random(seed))
        files = sorted(path for path in (tmp_path / folder).rglob("*") if path.is_file())
        contents.append([path.read_bytes().replace(str(tmp_path / folder).encode(), b"") for path in files])
    assert contents[0] == contents[1] or name == "log"  # whose metadata have the time of day and versions
    assert contents[0] != contents[2]


class Faulty(Parser):
    """A parser that fails as it is told."""

    error: BaseException | None = None

    def make(self, draw):
        """Nothing."""

    def feed(self):
        """Raises."""
        if self.error is not None:
            raise self.error


@pytest.mark.parametrize(
    ("error", "accepted", "fault"),
    [
        (None, True, None),
        (CarrlError("no track"), False, None),
        (CarrlError("two\nlines"), False, "a message that is not one line"),
        (KeyError("width"), False, "KeyError: 'width'"),
        (RecursionError("too deep"), False, "RecursionError: too deep"),
        (MemoryError(), False, "MemoryError"),
    ],
)
def test_whatever_is_no_carrl_error_is_a_fault(tmp_path, error, accepted, fault):
    parser = Faulty(tmp_path)
    parser.error = error
    verdict = judge(parser, 0, 0)
    assert verdict.accepted is accepted
    assert (verdict.fault is None) is (fault is None)
    assert (fault or "") in (verdict.fault or "")


def test_an_input_that_takes_long_is_a_fault(tmp_path, monkeypatch):
    monkeypatch.setattr(parser_module, "SLOW_S", -1)
    assert "it took 0.0 s" in (judge(Faulty(tmp_path), 0, 0).fault or "")


def test_an_input_without_end_is_ended_and_a_fault(tmp_path, monkeypatch):
    monkeypatch.setattr(parser_module, "HANGING_S", 1)
    parser = Faulty(tmp_path)
    monkeypatch.setattr(parser, "feed", lambda: parser_module.time.sleep(30))
    assert judge(parser, 0, 0).fault == "Hanging: no end after 1 s"


def test_faults_are_told_with_the_way_to_see_them_again_and_exit_code_1(monkeypatch, capsys):
    monkeypatch.setattr(Faulty, "error", KeyError("width"))
    monkeypatch.setattr(script, "PARSERS", {"faulty": Faulty})
    assert script.main(["faulty", "--inputs", "7", "--seed", "5"]) == 1
    printed = capsys.readouterr().out
    assert "| faulty | 7 | 0 | 0 | 7 | " in printed
    assert "FAULT in faulty, input 0: KeyError: 'width'; again: scripts/fuzz faulty --seed 5 --only 0" in printed
    monkeypatch.setattr(Faulty, "error", None)
    assert script.main(["all", "--inputs", "7"]) == 0
    assert "| faulty | 7 | 7 | 0 | 0 | " in capsys.readouterr().out
