"""What is typed after `carrl train`: nothing of it is ignored, and what cannot be read is answered with what can."""

import json
import subprocess
import sys

import pytest
import yaml

from carrl.cli.main import main
from carrl.config import config_dir
from carrl.errors import ConfigError
from carrl.targets import TARGETS
from carrl.train.composition import PLAIN_KEYS, nearest_keys, real_keys
from carrl.train.overrides import name_files, quote, readable_overrides, sort_arguments, unquote
from tests.configs import compose

TINY = ["compile=false", "track=oval", "env.num_envs=8", "trainer.frames=16", "replay_buffer.batch_size=16"]


def refused(capsys, *arguments):
    """The one sentence that answers these arguments."""
    assert main([*arguments]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    (sentence,) = (line for line in output.err.splitlines() if not line.startswith("training "))  # the first line
    return sentence.removeprefix("carrl: ")


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    """No test leaves or finds anything where it runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


IGNORED_ONCE = [
    (["+lr=0.01"], "there is no key lr; did you mean optimizer.lr?"),
    (["++lr=0.01"], "there is no key lr; did you mean optimizer.lr?"),
    (["lr=0.01"], "there is no key lr; did you mean optimizer.lr?"),
    (["-m", "+lr=0.01,0.1"], "there is no key lr; did you mean optimizer.lr?"),
    (["+lr=0.01,0.1", "-m"], "there is no key lr; did you mean optimizer.lr?"),
    (["+trainr.frames=9"], "there is no key trainr.frames; did you mean trainer.frames?"),
    (["+xyzzy={a: {b: 1}}"], "there is no key xyzzy.a.b; carrl train --cfg job shows all there are"),
    (["+alpha=1"], "there is no key alpha; did you mean loss.alpha or replay_buffer.alpha?"),
    (["los=dqn"], "there is no key los; did you mean loss?"),
    (["loss=dqnn"], "loss has no option dqnn; did you mean dqn, or one of: advantage_learning, cql, "),
    (["loss=3"], "loss has no option 3; choose one of: advantage_learning, cql, "),
    (["-m", "loss=3,4"], "loss has no option 3; choose one of: advantage_learning, cql, "),
    (["logger=null"], "logger has no option null; choose one of: csv, mlflow"),
    (["recorder=none"], "recorder is 'none', but it is made of keys; set recorder.envs or recorder.every_nth_episode"),
    (["returns=n_step"], "returns is 'n_step', but it is made of keys; set returns.steps, or returns=null"),
    (["sensor=3"], "sensor is 3, but it is made of keys; set sensor.dropout or sensor.field_of_view"),
    (["learning_rate=0.01"], "learning_rate has no option 0.01; did you mean optimizer.lr=0.01?"),
    (["experiment=fsat"], "experiment has no option fsat; did you mean fast, or one of: "),
    (["loss.gama=1"], "there is no key loss.gama; did you mean loss.gamma?"),
    (["+loss.gama=1"], "loss has no key 'gama'; make_dqn_loss takes gamma, "),
    (["loss.alpha=1"], "loss.alpha is a key of loss=advantage_learning, loss=cql and loss=sac only; choose one of"),
    (["data.updates=1"], "data.updates is a key of data=log only; choose it, too"),
    (["+learning_rate.final_share=1"], "learning_rate.final_share has no effect, as no learning_rate is chosen; add "),
    (["~loss"], "loss is left out, but training needs it; choose loss=advantage_learning|cql|"),
    (["~trainer"], "trainer is left out, but training needs it; do not delete it, nor write trainer=null"),
    (["~seed"], "seed is left out, but training needs it; write seed=VALUE"),
    (["~optimizr"], "there is no key optimizr; did you mean optimizer?"),
    (["+search.a=1"], "+search.a=1 has no effect on carrl train; carrl tune searches"),
    (["hydra.rum.dir=x"], "there is no key hydra.rum.dir; carrl train --cfg hydra shows all there are"),
    (["+hydra.run.foo=x"], "there is no key hydra.run.foo; carrl train --cfg hydra shows all there are"),
    (["hydra.sweep.dir=x"], "hydra.sweep.dir=x has no effect on a single run; add -m, or write hydra.run.dir="),
    (["hydra/launcher=basic"], "hydra/launcher=basic has no effect on a single run; add -m"),
    (["seed=3", "trainer.seeds=[4..5]"], "seed=3 has no effect beside trainer.seeds=['4..5'], which names the seed of"),
    (["experiment=tune", "seed=3"], "seed=3 has no effect beside trainer.seeds=['0..2'], which names the seed of"),
    (["-m", "seed=0,1", "trainer.seeds=[4..5]"], "seed=0,1 has no effect beside trainer.seeds=['4..5']"),
    (["-m", "hydra.run.dir=x"], "hydra.run.dir=x has no effect on a sweep; write hydra.sweep.dir=, or leave -m out"),
    (["hydra.run.dir="], "hydra.run.dir= lacks its value; write hydra.run.dir=FOLDER, or leave it out"),
    (["hydra.run.dir=' '"], "hydra.run.dir= lacks its value; write hydra.run.dir=FOLDER, or leave it out"),
    (["-m", "hydra.sweep.dir="], "hydra.sweep.dir= lacks its value; write hydra.sweep.dir=FOLDER, or leave it out"),
    (["-m", "hydra.sweep.subdir="], "hydra.sweep.subdir= lacks its value; write hydra.sweep.subdir=FOLDER, or leave"),
    (["resume=a", "resume=b"], "resume= is given 2 times; one run is resumed at a time"),
    (["--seed", "3"], "carrl train has no flag --seed; write seed=3"),
    (["--seed=3"], "carrl train has no flag --seed; write seed=3"),
    (["loss=dqn", "--lr", "0.1"], "carrl train has no flag --lr; write optimizer.lr=0.1"),
    (["--max-steps"], "carrl train has no flag --max-steps; write env.max_steps=VALUE"),
    (["--mulitrun"], "carrl train has no flag --mulitrun; did you mean --multirun?"),
    (["--verison"], "carrl train has no flag --verison; did you mean --version?"),
    (["--cfg"], "--cfg lacks its value; write --cfg job|hydra|all"),
    (["--cfg", "jobs"], "--cfg is 'jobs'; choose one of: job, hydra, all"),
    (["--resolve"], "--resolve has no effect without --cfg; add --cfg job, or leave --resolve out"),
    (["-m", "--info"], "--multirun and --info do not go together; give one of them"),
    (["seed"], "'seed' is no override; write seed=VALUE, or ~KEY to leave one out"),
    (["=3"], "'=3' has no key; write KEY=VALUE, such as seed=3"),
    (["a b=3"], "'a b=3' cannot be read: 'a b' is no key; write KEY=VALUE, such as seed=3"),
    (["hydra.job.name=a=b"], "or quote the value: \"hydra.job.name='a=b'\""),
    (["-m", "seed=rang(0,3)"], "'seed=rang(0,3)' cannot be read: 'rang(0,3)': Unknown function 'rang'"),
    (["trainer.frames=1e5"], "trainer.frames is 100000.0; it must be of type int; write 100000"),
    (["network.hidden_sizes=[1e1]"], "write [10]"),
    (["recorder.envs=1e1"], "recorder.envs is 10.0; it must be of type int | None; write 10"),
    (["seed=0,1"], "seed=0,1 has several values; add -m to train with each, or write a list as trainer.seeds=[A,B]"),
    (["seed=[0,1]"], "2^63; several side by side are trainer.seeds=[0, 1]"),
    (["seed=1e3"], "seed is 1000.0; it must be a whole number of at least 0 and less than 2^63; write 1000"),
    (["threads=true"], "threads is True; it must be a whole number from 1 to 1024"),
    (["threads=99999999999"], "threads is 99999999999; it must be a whole number from 1 to 1024"),
    (["trainer.seeds=[true]"], "it must be of type"),
    (["vehicle.speed=true"], "vehicle.speed is True"),
]


@pytest.mark.parametrize(("arguments", "says"), IGNORED_ONCE, ids=[" ".join(each) for each, _ in IGNORED_ONCE])
def test_what_has_no_effect_is_refused_and_leaves_nothing_behind(arguments, says, capsys, empty_folder):
    assert says in refused(capsys, "train", *arguments)
    assert [path for path in empty_folder.rglob("*") if path.is_file()] == []


def test_a_later_option_of_a_sweep_is_checked_before_its_first_job(capsys, empty_folder):
    says = "loss has no option dqnn; did you mean dqn, or one of: advantage_learning, cql"
    assert refused(capsys, "train", "-m", *TINY, "loss=dqn,dqnn").startswith(says)
    assert not list(empty_folder.rglob("train.mcap"))


def test_an_experiment_file_of_ones_own_counts_for_every_key(empty_folder):
    experiments = empty_folder / "mine" / "experiment"
    experiments.mkdir(parents=True)
    (experiments / "good.yaml").write_text("# @package _global_\nseed: 7\ntrainer:\n  frames: 16\n")
    typed = [each for each in TINY if not each.startswith("trainer.")]
    assert main(["train", "experiment=good", *typed, "hydra.run.dir=run", "--config-dir", "mine"]) == 0
    assert json.loads((empty_folder / "run" / "summary.json").read_text())["seed"] == 7


def test_a_misspelt_verb_is_answered_with_the_nearest(capsys):
    assert refused(capsys, "trian").startswith("no verb 'trian'; did you mean train? choose one of: train, tune")


@pytest.mark.parametrize("flags", [["--config-dir", "mine"], ["-cd", "mine"], ["--config-dir=mine", "-m"]])
def test_an_experiment_file_of_ones_own_is_checked_as_what_is_typed(flags, empty_folder, capsys):
    experiments = empty_folder / "mine" / "experiment"
    experiments.mkdir(parents=True)
    (experiments / "bad.yaml").write_text("# @package _global_\nlr: 0.1\n")
    (experiments / "again.yaml").write_text("# @package _global_\nresume: outputs/run\n")
    assert refused(capsys, "train", *flags, "experiment=bad") == "there is no key lr; did you mean optimizer.lr?"
    says = "resume is 'outputs/run'; it counts only where it is typed, as in carrl train resume=RUN"
    assert refused(capsys, "train", *flags, "experiment=again", *TINY) == says


@pytest.mark.parametrize("flags", [[], ["-m"]])
def test_an_experiment_file_that_cannot_be_read_is_one_sentence(flags, empty_folder, capsys):
    experiments = empty_folder / "mine" / "experiment"
    experiments.mkdir(parents=True)
    (experiments / "open.yaml").write_text("# @package _global_\nseed: [\n")
    (experiments / "pair.yaml").write_text("# @package _global_\n? [seed, device]\n: 3\n")
    (experiments / "dangling.yaml").write_text("# @package _global_\nseed: ${nowhere}\n")
    typed = ["train", "--config-dir", "mine", *flags]
    for name in ("open", "pair"):
        says = refused(capsys, *typed, f"experiment={name}")
        assert says.startswith("a file of the configuration is no YAML that Hydra reads: while ")
        assert f"{name}.yaml" in says
    assert "'nowhere' not found" in refused(capsys, *typed, "experiment=dangling")


@pytest.mark.parametrize("typed", ["resume=", "+resume=", "resume=''"])
def test_a_resume_of_nothing_is_answered_with_what_it_lacks(typed, capsys, empty_folder):
    assert refused(capsys, "train", typed) == "resume= lacks its value; write resume=RUN, with the folder of a run"
    assert list(empty_folder.iterdir()) == []


def test_the_known_keys_are_those_of_the_configuration():
    content = yaml.safe_load((config_dir() / "train.yaml").read_text())
    groups = {key for each in content["defaults"] if isinstance(each, dict) for key in each if " " not in key}
    nodes = {key for key, value in content.items() if isinstance(value, dict)} - {"hydra"}
    assert groups - {"_self_", "experiment"} | nodes == set(TARGETS)
    assert content.keys() - {"defaults", "hydra"} - nodes == set(PLAIN_KEYS) - {"search"}
    assert {"optimizer.lr", "loss.alpha", "data.path", "track.folder", "trainer.seeds"} <= set(real_keys())


def test_every_leaf_of_the_default_configuration_is_its_own_nearest_key():
    for leaf in _leaves("", compose()):
        if "." in leaf and "._" not in leaf:
            assert leaf in nearest_keys(leaf)


def _leaves(name, node):
    """The full names of the keys that have no further ones."""
    if not isinstance(node, dict):
        return [name]
    return [leaf for key, value in node.items() for leaf in _leaves(f"{name}.{key}".lstrip("."), value)]


def test_flags_may_stand_anywhere():
    typed = sort_arguments(["a=1", "-m", "b=2", "-cd", "mine", "-c=job".replace("-c=", "--cfg=")][:5])
    assert (typed.flags, typed.overrides) == (("--multirun", "--config-dir=mine"), ("a=1", "b=2"))
    assert sort_arguments(["--info", "seed=1"]).flags == ("--info=all",)
    assert sort_arguments(["seed=1", "-i", "config"]).flags == ("--info=config",)


def test_a_sweep_with_its_flag_last_trains_every_job(empty_folder):
    assert main(["train", *TINY, "seed=0,1", "hydra.sweep.dir=many", "-m"]) == 0
    assert sorted(path.name for path in (empty_folder / "many").glob("seed=*")) == ["seed=0", "seed=1"]


def test_a_seed_counts_for_the_job_of_a_sweep_that_has_no_others(empty_folder):
    assert main(["train", "-m", *TINY, "seed=3", "trainer.seeds=[4..5],null", "hydra.sweep.dir=s"]) == 0
    assert (empty_folder / "s" / "trainer.seeds=null" / "summary.json").exists()


def test_a_folder_with_an_equals_sign_in_its_name_needs_no_quotes(empty_folder):
    assert main(["train", *TINY, "hydra.run.dir=outputs/lr=0.001,seed=0"]) == 0
    log = "outputs/lr=0.001,seed=0/train.mcap"
    assert (empty_folder / log).exists()
    learning = ["train", "compile=false", "data=log", "data.updates=2", "replay_buffer.batch_size=4", "track=oval"]
    assert main([*learning, f"data.path={log}", "hydra.run.dir=whole"]) == 0
    assert main([*learning, f"data.path=[{log},{log}]", "hydra.run.dir=list"]) == 0
    counts = [
        json.loads((empty_folder / name / "summary.json").read_text())["transitions"] for name in ("whole", "list")
    ]
    assert counts == [16, 32]


def test_a_run_is_resumed_by_its_name_in_quotes(empty_folder):
    assert main(["train", *TINY, "hydra.run.dir=a=b"]) == 0
    assert main(["train", "resume='a=b'", "trainer.frames=32"]) == 0
    assert json.loads((empty_folder / "a=b" / "summary.json").read_text())["frames"] == 32


def test_tracks_by_name_and_by_file_share_a_sweep(empty_folder, capsys):
    corners = [[0, 0], [60, 0], [60, 60], [0, 60]]
    (empty_folder / "a.yaml").write_text(yaml.safe_dump({"corners": corners, "corner_radius": 15, "width": 9}))
    assert main(["train", "-m", *TINY[:1], *TINY[2:], "track=a.yaml,oval", "hydra.sweep.dir=many"]) == 0
    tracks = [json.loads(path.read_text())["track"] for path in sorted((empty_folder / "many").rglob("summary.json"))]
    assert tracks == ["a.yaml", "oval"]
    says = "track=random does not go with files in one sweep; run a sweep of its own for it"
    capsys.readouterr()
    assert refused(capsys, "train", "-m", "track=a.yaml,random") == says


def test_paths_that_are_there_are_taken_whole(empty_folder):
    for name in ("a,b", "c=d", "it's"):
        (empty_folder / name).mkdir()
    here = str(empty_folder)
    assert name_files("track.folder=a,b") == [f"track.folder='{here}/a,b'"]
    assert name_files("data.path=[a,b,c=d]") == [f"data.path=['{here}/a,b','{here}/c=d']"]
    assert name_files("data.path=x,y") == [f"data.path='{here}/x','{here}/y'"]
    assert name_files("data.path='x,y',z") == [f"data.path='{here}/x,y','{here}/z'"]
    assert name_files("track=it's/a.csv") == ["track=file", f"track.name_or_path='{here}/it\\'s/a.csv'"]
    assert name_files("logger.tracking_uri=c=d") == ["logger.tracking_uri='c=d'"]
    assert name_files("seed=3") == ["seed=3"]


@pytest.mark.parametrize(
    "text", ["plain", "a=b", "a,b", "it's", 'say "x"', "a\\", "a\\'b", "[x", "${now:%Y}", "ä ö", ""]
)
def test_what_is_quoted_is_read_back(text):
    from hydra.core.override_parser.overrides_parser import OverridesParser

    assert OverridesParser.create().parse_override(f"a={quote(text)}").value() == text


def test_quotes_around_a_value_are_taken_off():
    assert [unquote(text) for text in ("'a=b'", '"a b"', "a", "it's", r"'it\'s'")] == [
        "a=b",
        "a b",
        "a",
        "it's",
        "it's",
    ]


@pytest.mark.parametrize(
    "typed", ["a=1 2", "device=it's", "seed=[1", "track.width={a: 1", "device='cpu", "hydra.job.name=a=b,c"]
)
def test_the_quoting_that_a_message_shows_is_right(typed):
    try:
        readable_overrides([typed], is_sweep=False)
    except ConfigError as error:
        shown = str(error).partition("quote the value: ")[2]
        unshelled = subprocess.run(
            ["bash", "-c", f"printf %s {shown}"], capture_output=True, text=True, check=True
        ).stdout
        readable_overrides([unshelled], is_sweep=False)


def test_checking_what_is_typed_does_not_wait_for_torch():
    program = """
import sys
from carrl.cli.main import main
for arguments in (["+lr=1"], ["-m", "+lr=1,2"], ["loss=dqnn"], ["--seed", "3"], ["~loss"]):
    assert main(["train", *arguments]) == 2
assert "torch" not in sys.modules
"""
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert finished.returncode == 0, finished.stderr
    assert len(finished.stderr.splitlines()) == 5


@pytest.mark.parametrize(
    "verb", [[], ["tune"], ["evaluate", "run"], ["report", "run"], ["log", "check", "a"], ["track", "list"]]
)
def test_a_misspelt_flag_of_carrl_itself_is_answered_with_it_after_each_verb(verb, capsys):
    assert "; did you mean --version?" in refused(capsys, *verb, "--verison")


@pytest.mark.parametrize("flag", [["tune", "--folder"], ["report", "run", "--out"]])
def test_a_flags_folder_without_a_name_is_refused(flag, capsys):
    assert f"argument {flag[-1]}: it lacks its value; name a folder" in refused(capsys, *flag, "")
