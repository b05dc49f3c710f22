"""Options of all commands: beside which others each has no effect, and which of them name files to write."""

import pytest

from cyclofeat.cli import COMMANDS, command_module, main, make_parser
from cyclofeat.cli._options import name_of

PARSERS = make_parser()._subparsers._group_actions[0].choices
ACTIONS = {
    command: {name_of(action): action for action in parser._actions} for command, parser in PARSERS.items()
}

# Options that take a text and name no new file: what is read, words, and what a later call goes on with.
NO_TARGETS = {
    "--channel", "--time-channel", "--angle-channel",  # names of channels
    "--worn-lobes", "--removed-lobes", "--effects", "--allow", "--scheduler", "--hold-out",  # words
    "--model", "--coarser", "--domain-of",
    "--rig", "--simulator", "--simulated", "--effects-from", "--posterior",  # read
    "--verify",  # read
    "--done", "--features", "--cache", "--history",  # gone on with
    "--gearbox",  # names
}  # fmt: skip
GONE_ON_WITH = {("campaign", "--out")}  # a campaign that does not suit the folder is refused


@pytest.fixture(autouse=True)
def no_work(monkeypatch):
    """Let no command do anything: what gets as far as its work is an error that says so."""

    def reached(arguments):
        raise ValueError("the work is reached")

    for command in COMMANDS:
        monkeypatch.setattr(command_module(command), "run", reached)


def words_of(action, value="x"):
    """An argument as it is typed, with a value that it takes."""
    if action.nargs == 0:
        return action.option_strings[:1]
    if action.choices:
        value = next(iter(action.choices)) if value == "x" else value
    elif action.type is not None:
        value = "2"
    return [*action.option_strings[:1], value]


def said(capsys, command, *given, **values):
    """What a call with the arguments named says, and those without which it is not understood."""
    given = dict(one.partition(" ")[::2] for one in given)
    words = [command]
    for name, action in sorted(ACTIONS[command].items(), key=lambda item: not item[1].option_strings):
        if name in given or (action.required and action.nargs != "*"):
            words += words_of(action, given.get(name, "").replace("*", "x") or values.get(name, "x"))
    code = main(words)
    assert code == 2
    return capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_an_argument_without_effect_is_refused_by_name_before_any_work(capsys, command):
    for names, beside, without in PARSERS[command].idle:
        for name in names:
            for other in beside:
                reason = f"with {other.replace('*', 'x')}"
                assert f"error: {name} has no effect {reason}: leave it out" in said(
                    capsys, command, name, other
                )
            if without:
                text = said(capsys, command, name)
                assert f"error: {name} has no effect without " in text
                assert all(other in text for other in without)
            for other in without:
                assert f"{name} has no effect without" not in said(capsys, command, name, other)


@pytest.mark.parametrize("command", COMMANDS)
def test_rules_of_arguments_without_effect_name_arguments_of_the_command(command):
    rules = PARSERS[command].idle
    names = {name.split()[0] for rule in rules for part in rule for name in part}
    assert names <= set(ACTIONS[command])


def test_what_is_typed_leaves_the_defaults_alone():
    arguments = make_parser(["simulate"]).parse_args(["simulate", "--out", "x.npz", "--worn-count", "3"])
    assert arguments.typed == {"--out": "x.npz", "--worn-count": 3}
    assert (arguments.duration, arguments.effects_from, arguments.force) == (3.0, [], False)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        # Typed is also a value that is the default.
        ("simulate --out x --worn-count 3 --wear-um 30 --depth=1", "--depth has no effect with --wear-um:"),
        ("simulate --out x --worn-count 3 --wear-um 30 --dep 1", "--depth has no effect with --wear-um:"),
        (
            "train --out x --rig R1 --effects-from a.py --effects-from b.py",
            "-from has no effect with --rig R1",
        ),
        ("train --out x --rig=published --effects-from a.py", "--effects-from has no effect with --rig publ"),
        ("train --out x --wear 5:200 --mixed-wear 60:200", "--mixed-wear: not allowed with argument --wear"),
        ("count x --report a.html --csv a.html", "--report and --csv must name different files, both are a"),
    ],
)
def test_an_argument_of_any_spelling_may_be_refused(words, message, capsys):
    assert main(words.split()) == 2
    assert message in capsys.readouterr().err


# -- files to write


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_that_names_something_is_known_to_be_written_or_not(command):
    targets = PARSERS[command].targets
    for name, action in ACTIONS[command].items():
        names_something = action.option_strings and action.nargs != 0 and not (action.type or action.choices)
        if names_something and (command, name) not in GONE_ON_WITH:
            assert (name in targets) != (name in NO_TARGETS), name


@pytest.mark.parametrize(
    ("command", "option", "kind"),
    [
        (command, option, kind)
        for command, parser in PARSERS.items()
        for option, kind in parser.targets.items()
    ],
)
def test_nothing_is_overwritten_unasked(capsys, tmp_path, command, option, kind):
    path = tmp_path / {"page": "a.html", "model": "a.joblib", "folder": "a"}.get(kind, "a.csv")
    content = path
    if kind == "folder":
        path.mkdir()
        content = path / "kept"
    content.write_text("kept", encoding="utf-8")
    refused = f"{path} exists: give {option} another name, or --force to overwrite it"
    idle = PARSERS[command].idle
    others = [f"{one[0]} {tmp_path / 'b.json'}" for names, _, one in idle if option in names and one]

    def answer(*more):
        return said(capsys, command, option, *others, *more, **{option: str(path)})

    assert refused in answer()
    assert content.read_text(encoding="utf-8") == "kept"
    assert "the work is reached" in answer("--force")
    content.unlink()
    assert "the work is reached" in answer()


def test_the_card_of_another_model_is_not_overwritten(capsys, tmp_path):
    (tmp_path / "m.joblib.card.json").write_text("{}", encoding="utf-8")
    assert main(["train", "--out", str(tmp_path / "m.joblib")]) == 2
    assert "m.joblib.card.json exists: give --out another name" in capsys.readouterr().err
