"""The table "What is read" in docs/log-format.md: every cell of it, by the readers themselves."""

import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader

from carrl.errors import LogError
from carrl.log import Log, recover
from tests.cli.log.conftest import write_log
from tests.log.rewriting import VARIANTS, rewrite

NODE_READER = Path(__file__).parent / "node_reader"
TOPICS = {"/transitions": 18, "/episodes": 5, "/metrics": 3}
PAGE = (Path(__file__).parents[2] / "docs" / "log-format.md").read_text()
READERS = ("CarRL", "mcap (Python)", "@mcap/core (node)", "Rerun")
FURTHER = ("as CarRL writes it", "two logs merged", "unfinished", "recovered")


def table():
    """The cells by file and reader."""
    lines = PAGE[PAGE.index("## What is read") :].split("\n\n")
    rows = next(part for part in lines if part.startswith("| the file |")).splitlines()
    heading, _, *rest = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    return {row[0]: dict(zip(heading[1:], row[1:], strict=True)) for row in rest}


TABLE = table()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Each file of the table."""
    folder = tmp_path_factory.mktemp("files")
    log, other = write_log(folder / "log.mcap"), write_log(folder / "other.mcap")
    found = {name: folder / f"{number}.mcap" for number, name in enumerate([*VARIANTS, *FURTHER])}
    for name, options in VARIANTS.items():
        rewrite(log, found[name], **options)
    shutil.copy(log, found["as CarRL writes it"])
    rewrite(log, found["two logs merged"], other)
    found["unfinished"].write_bytes(log.read_bytes()[:-500])
    recover(found["unfinished"], found["recovered"])
    return found


def cell(topics, attachments, metadata, logs=1):
    """What the table says where a reader finds this many messages by topic, attachments and metadata records."""
    if not any(topics.values()):
        return "no messages"
    assert topics == {topic: logs * count for topic, count in TOPICS.items()}
    return "all" if attachments and metadata else "no metadata" if attachments else "no attachments"


def logs_in(name):
    return 2 if name == "two logs merged" else 1


def read_by_carrl(path):
    try:
        with Log(path) as log:
            transitions = sum(len(columns["action"]) for columns in log.batches())
            topics = {"/episodes": len(list(log.episodes())), "/metrics": len(list(log.metrics()))}
            assert transitions == 54
            return cell({"/transitions": 18, **topics}, len(log.attachments), len(log.metadata))
    except LogError as error:
        return "two runs" if "holds 2 logs" in str(error) else "unfinished" if "unfinished" in str(error) else error


def read_by_mcap(path, name):
    try:
        with path.open("rb") as file:
            reader = make_reader(file)
            topics = Counter(channel.topic for _, channel, _ in reader.iter_messages())
            return cell(topics, len(list(reader.iter_attachments())), len(list(reader.iter_metadata())), logs_in(name))
    except (McapError, KeyError):
        return "error"


@pytest.fixture(scope="module")
def node(files):
    """What @mcap/core finds in each file."""
    if shutil.which("node") is None or not (NODE_READER / "node_modules").is_dir():
        pytest.skip("@mcap/core is not installed; npm ci --prefix tests/log/node_reader")
    paths = list(map(str, files.values()))
    finished = subprocess.run(["node", NODE_READER / "read.mjs", *paths], capture_output=True, text=True, check=True)
    answers = json.loads(finished.stdout)
    return {name: answers[str(path)] for name, path in files.items()}


def read_by_rerun(path, name, target):
    from rerun.chunk import RrdReader

    command = [sys.executable, "-m", "rerun", "mcap", "convert", path, "-o", target]
    subprocess.run(command, capture_output=True, check=True)
    topics, entities = Counter(), set()
    try:
        chunks = list(RrdReader(target).stream())
    except ValueError as error:
        assert "No recording store" in str(error)
        return "nothing"
    for chunk in chunks:
        entities.add(chunk.entity_path)
        if not chunk.is_static:
            topics[chunk.entity_path] += chunk.to_record_batch().num_rows
    return cell(topics, "/__mcap_attachments" in entities, "/__mcap_metadata" in entities, logs_in(name))


def test_the_table_has_a_row_for_each_file_and_a_column_for_each_reader():
    assert sorted(TABLE) == sorted([*VARIANTS, *FURTHER])
    assert all(tuple(row) == READERS for row in TABLE.values())


@pytest.mark.parametrize("name", TABLE)
def test_carrl_reads_what_the_table_says(files, name):
    assert read_by_carrl(files[name]) == TABLE[name]["CarRL"]


@pytest.mark.parametrize("name", TABLE)
def test_mcap_for_python_reads_what_the_table_says(files, name):
    assert read_by_mcap(files[name], name) == TABLE[name]["mcap (Python)"]


@pytest.mark.parametrize("name", TABLE)
def test_mcap_for_node_reads_what_the_table_says(files, node, name):
    found = node[name]["indexed"]
    assert TABLE[name]["@mcap/core (node)"] == ("error" if "error" in found else cell(**found, logs=logs_in(name)))


@pytest.mark.parametrize("name", TABLE)
def test_rerun_reads_what_the_table_says(files, tmp_path, name):
    pytest.importorskip("rerun")
    assert read_by_rerun(files[name], name, tmp_path / "out.rrd") == TABLE[name]["Rerun"]


@pytest.mark.parametrize("name", TABLE)
def test_the_readers_that_need_no_index_read_all_of_every_file(files, node, name):
    assert cell(**node[name]["streamed"], logs=logs_in(name)) == "all"
    topics = Counter()
    with files[name].open("rb") as file:
        try:
            for _, channel, _ in NonSeekingReader(file).iter_messages(log_time_order=False):
                topics[channel.topic] += 1
        except Exception:  # of an unfinished file mcap raises whatever its cut leads to
            assert name == "unfinished"
    assert cell(topics, True, True, logs_in(name)) == "all"
