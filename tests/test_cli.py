"""The command `swarm-envs`: its commands, its help, its exit codes."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import swarm_envs
from swarm_envs.cli import COMMANDS, PROGRAM, main, read_options
from swarm_envs.files import written_whole


def test_no_command_and_help_list_every_command(capsys):
    assert main([]) == 2
    assert main(["--help"]) == 0
    listed = capsys.readouterr().out
    assert all(listed.count(f"\n  {name} ") == 2 for name in COMMANDS)


@pytest.mark.parametrize(
    "words",
    [
        *("--help", "fly --help", "train -h"),
        "evaluate --agent hover --episodes 1 --drones 2 --horizon-s 0.5",
    ],
)
def test_of_an_output_the_head_alone_may_be_read(words):
    script = [sys.executable, "-m", "swarm_envs", *words.split()]
    with subprocess.Popen(script, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        running.stdout.close()
        said = running.stderr.read()
        assert said == b"" or (words.startswith("evaluate") and b"Error" not in said)  # its bar
    assert running.returncode == 0


def test_help_texts_are_wrapped_to_the_window(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(["fly", "--help"])
    lines = [line.strip("│ \n") for line in capsys.readouterr().out.splitlines()]
    start = next(i for i, line in enumerate(lines) if line.startswith("--task"))
    assert lines[start].endswith("delivery, gates,")
    assert lines[start + 1] == "pursuit or crowd, optionally with a version, such as"


@pytest.mark.parametrize(
    ("encoding", "printed"),
    [
        ("ascii", b"\\xdcbung-\\u8702"),
        ("cp1252", b"\xdcbung-\\u8702"),
        ("utf-8", "Übung-蜂".encode()),
    ],
)
def test_names_that_the_output_s_encoding_lacks_are_escaped(encoding, printed, tmp_path):
    folder = tmp_path / "Übung-蜂"
    script = [sys.executable, "-m", "swarm_envs", "assignment", "start", "controller", str(folder)]
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    done = subprocess.run(script, capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert printed + b"; read " in done.stdout
    assert (folder / "README.md").exists()


@pytest.mark.parametrize("words", [["--out", ""], ["--out="], ["--agent"]])
def test_a_value_that_is_empty_is_refused(words, capsys):
    """`--out ""` is no name for the current folder, as of a variable that is not set."""
    assert main(["evaluate", *words]) == 2
    assert "leave the option out" in capsys.readouterr().err or words == ["--agent"]


def test_an_error_in_a_user_s_file_is_one_sentence_with_its_line(tmp_path, capsys):
    pytest.importorskip("stable_baselines3")
    source = Path(__file__).parent.parent / "examples" / "own_task.py"
    code = source.read_text(encoding="utf-8").replace("self.spacing_m * (", "self.spacing_n * (")
    file = tmp_path / "line.py"
    file.write_text(code, encoding="utf-8")
    number = 1 + next(k for k, line in enumerate(code.splitlines()) if "self.spacing_n" in line)
    words = ["train", "--algo", "ppo", "--steps", "100", "--out", str(tmp_path / "out")]
    assert main([*words, "--task", f"{file}:LineTask"]) == 1
    (said,) = capsys.readouterr().err.strip().splitlines()[-1:]
    assert f"line {number} of {file} raises AttributeError: " in said


def test_the_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"swarm-envs {swarm_envs.__version__}\n"


@pytest.mark.parametrize("module", ["swarm_envs", "swarm_envs.cli"])
def test_the_program_exits_with_the_command_s_code(module):
    script = [sys.executable, "-m", module, "dmeo"]
    done = subprocess.run(script, capture_output=True, text=True)
    assert done.returncode == 2
    assert "unknown command 'dmeo'; did you mean 'demo'?" in done.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_help_explains_every_option_and_its_example_is_read(command, capsys):
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    # What draws nothing at random needs no seed.
    assert "--seed" in text or command in ("assignment", "compile")
    assert "--out" in text or command in ("assignment", "compile")
    assert not re.search(r"--[a-z.-]+ [^ ]+, --", text)  # each option has one name
    assert not re.search(r"--num-(drones|neighbors|episodes)", text)
    example = COMMANDS[command].example
    assert f"Example: {PROGRAM} {command} {example}" in " ".join(text.split())
    read_options(command, example.split())


@pytest.mark.parametrize("columns", ["1", "30", "200"])
def test_a_help_ends_in_a_window_of_any_width(columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", columns)
    with pytest.raises(SystemExit):
        main(["fly", "--help"])
    assert "--on-contact" in capsys.readouterr().out
    assert os.environ["COLUMNS"] == columns


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("fly --world hal", "--world is 'hal'; did you mean 'hall'? valid: 'hall', 'ideal' (see"),
        ("grade --assignment contoller", "unknown assignment 'contoller'; did you mean"),
        ("grade --assignment swap", "--agent is empty"),
        ("grade --assignment swap --agent a --limit-s 0", "--limit-s is 0.0, but must be positive"),
        ("train --out a --algo=pppo", "unknown --algo 'pppo'; did you mean 'ppo'?"),
        ("assignment strat swap", "command is 'strat'; did you mean 'start'? valid: 'list'"),
        ("demo --swaps many", "--swaps is 'many', but must be an integer"),
        ("fly --drones four", "--drones is 'four', but must be an integer"),
        ("fly --observe-loss 10%", "--observe-loss is '10%', but must be a number"),
        ("fly --drones", "Missing value for argument '--drones'"),
        (
            "fly --drones 0",
            "--drones is 0, but must be an integer of at least 1 and at most 100,000",
        ),
        ("fly --drones 4 --team SS", "error: --drones is 4, but --team SS has 2; give one of them"),
        ("fly --horizon-s nan", "error: --horizon-s is nan, but must be positive and finite"),
        ("fly --agent swap-dagger orca", "Unrecognized options: orca"),
        ("evaluate --workers -1", "error: --workers is -1, but must be an integer of at least 1"),
        ("evaluate --force-rate 7", "--force-rate is 7, but must be 240 over an integer"),
        ("train --out a --steps 1e5", "--steps is '1e5', but must be an integer"),
        ("train --out a --algo PPO", "unknown --algo 'PPO'; did you mean 'ppo'?"),
        ("train --out a --dagger.guided 2", "--dagger.guided is 2.0, but must be a number"),
        ("train --out a --num-neighbors 1", "Unrecognized options: --num-neighbors"),
        ("train", "Missing from swarm-envs train: --out PATH"),
        ("assignment", "{list,start}"),
        ("fly --on-contact explode", "--on-contact is 'explode'; valid: 'bounce'"),
        ("train --out a --drones 4 six", "six"),
        ("demo --swap 3", "--swap, 3; did you mean --swaps? (see"),
        ("fly --dorens 4", "--dorens, 4; did you mean --drones? (see"),
        ("train --out a --no-progres", "did you mean --no-progress? (see"),
        ("fly swap", "Unrecognized options: swap; did you mean --task swap? (see"),
        ("fly ring_v0", "Unrecognized options: ring_v0 (see"),
        ("train --out a --neighbor 3", "did you mean --neighbors? (see"),
        ("train --out a --no-observe-forces", "did you mean --no-observe-force? (see"),
        ("train --out o --batch-size 3", "did you mean --dagger.batch-size? (see"),
        ("train --out o --step 3 --hiden 3", "did you mean --steps and --hidden? (see"),
        ("fly --gama 0.9", "Unrecognized options: --gama, 0.9 (see"),
        ("demo --video no", "Unrecognized options: no"),
    ],
)
def test_a_word_that_a_command_does_not_take_is_named_in_one_line(line, said, capsys):
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Options" not in error and "\u2500" not in error
    assert len(error.splitlines()) == 1
    assert error.startswith(f"{PROGRAM} {line.split()[0]}: error: ")
    assert error.endswith(f"(see `{PROGRAM} {line.split()[0]} --help`)\n")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("demo --seed -3", "--seed is -3, but must be an integer of at least 0"),
        ("demo --swaps 0", "--swaps is 0, but must be an integer of at least 1 and at most 1,000"),
        ("collect --interactions learned-v0", "'learned-v0'; did you mean 'learned'?"),
        ("collect --feedforward learned-v0", "'learned-v0'; did you mean 'learned'?"),
        ("train --algo dagger --dagger.teacher circle=orka", "'orka'; did you mean 'orca'?"),
        ("train --set foo", "--set has 'foo', but must have NAME=VALUE"),
        ("train --set n_stops=8", "--algo ppo refuses its arguments: unknown argument 'n_stops'"),
        ("train --algo os.path", "--algo is 'os.path', which is no algorithm"),
        ("train --algo sb4.Nope", "must be one of ppo, sac, td3, dagger, an import path"),
        ("train --controller downwash-awre", "did you mean 'downwash-aware'?"),
        ("fly --agent=", "the value of an option is empty"),
        ("fly --agent=+filter", "name is '', but must be an agent's"),
    ],
)
def test_bad_values_are_refused_before_anything_is_written(line, said, tmp_path, refused):
    assert said in refused(*line.split(), "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_an_option_can_take_is_read():
    words = "--drones None --world hall --task swap --randomization mass=1:2 --horizon-s 1e1"
    options = read_options("fly", words.split())
    assert (options.drones, options.world, options.horizon_s) == (None, "hall", 10.0)
    words = "--out a --drones 4 6 --algo dagger --dagger.guided 0.1 --no-progress --neighbors 3"
    options = read_options("train", words.split())
    assert (options.drones, options.dagger.guided, options.progress) == ((4, 6), 0.1, False)
    assert options.num_neighbors == 3


WITHOUT_TORCH = """
import sys
import time
from importlib.machinery import PathFinder

class WithoutTorch:
    @staticmethod
    def find_spec(name, path=None, target=None):
        hidden = name.partition(".")[0] == "torch"
        return None if hidden else PathFinder.find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = WithoutTorch
from swarm_envs.cli import main
"""


def run_without_torch(*arguments: str) -> subprocess.CompletedProcess[str]:
    script = WITHOUT_TORCH + f"sys.exit(main({list(arguments)!r}))"
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)


def test_a_fit_without_torch_says_how_to_get_it(tmp_path):
    (data := tmp_path / "rows.npz").touch()
    done = run_without_torch("fit", "--data", str(data), "--out", str(tmp_path / "out"))
    assert done.returncode == 1
    assert "pip install 'swarm-envs[train]'" in done.stderr
    assert "CPU build of torch" in done.stderr
    assert not (tmp_path / "out").exists()


def test_what_fails_later_is_a_failure(capsys, tmp_path):
    pytest.importorskip("torch")
    data, out = tmp_path / "rows.npz", tmp_path / "out"
    assert main(["fit", "--data", str(data), "--out", str(out)]) == 2  # there is no such file
    data.write_text("no rows")
    assert main(["fit", "--data", str(data), "--out", str(out)]) == 1
    assert "swarm-envs fit: error:" in capsys.readouterr().err


def test_sigterm_leaves_no_partial_file(tmp_path, monkeypatch):
    def write(options):
        with written_whole(tmp_path / "a.json") as partial:
            partial.touch()
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)

    monkeypatch.setattr("swarm_envs.commands.fly.run_fly", write)
    assert main(["fly"]) == 130
    assert not [*tmp_path.iterdir()]
