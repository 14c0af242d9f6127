"""What commands do that ask people."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from moral_algorithms import pipeline
from moral_algorithms.cli.console import Console
from moral_algorithms.live import launch
from moral_algorithms.live.session import LiveSession, hold_session
from moral_algorithms.pipeline import MoralRun
from moral_algorithms.run_directory import RunDirectory
from moral_algorithms.storage import StorageError, read_json, write_json

# Characters that the page has room for beside its charts.
_LONGEST_NAME = 18

_PEOPLE = "people.json"


@dataclass(frozen=True)
class Answering:
    """How people answer, as a run remembers it for when it goes on."""

    who: str = "anonymous"
    """Who answers."""
    notice: str | None = None
    """What must be accepted before the first question."""
    names: dict[str, str] = field(default_factory=dict)
    """What people read for components, where that is not their default."""

    def name_components(self, run: MoralRun) -> dict[str, str]:
        """Find what people read for each component of the reward vector.

        Raises
        ------
        ValueError
            If a name is given to what is no component, is another's, or does not fit beside a chart.
        """
        components = pipeline.component_names(run)
        for component, name in self.names.items():
            if component not in components:
                raise ValueError(f"names has {component!r}; it must be one of {', '.join(components)}")
            if not 0 < len(name.strip()) <= _LONGEST_NAME or not name.isprintable():
                raise ValueError(
                    f"the name of {component} is {name!r}; it must have 1 to {_LONGEST_NAME} characters"
                )
        given = {component: name.strip() for component, name in self.names.items()}
        learned = components[len(run.primary) :]
        experts = ["the expert"] if len(learned) == 1 else [f"expert {i + 1}" for i in range(len(learned))]
        names = {**dict(zip(components, (*run.primary, *experts), strict=True)), **given}
        if len(set(names.values())) < len(names):
            raise ValueError(f"names makes them {', '.join(names.values())}; no two may be the same")
        return names

    def save(self, directory: RunDirectory) -> None:
        """Keep it in the run directory."""
        write_json(directory.path / _PEOPLE, asdict(self))

    @classmethod
    def saved(cls, directory: RunDirectory) -> Answering:
        """Read what :meth:`save` kept; the defaults where it kept nothing.

        Raises
        ------
        StorageError
            If the file is damaged.
        """
        path = directory.path / _PEOPLE
        if not path.exists():
            return cls()
        match read_json(path):
            case {"who": str(who), "notice": str() | None as notice, "names": dict(names)} if all(
                isinstance(name, str) for name in names.values()
            ):
                return cls(who, notice, names)
            case found:
                raise StorageError(f"{path} is damaged: it holds {found!r}, not who, notice and names")


@dataclass(frozen=True)
class People:
    """Options of how people answer. A run that goes on remembers who, notice and names that are not given."""

    who: str | None = None
    """Who answers; goes into the record. Without it, anonymous."""
    notice: Path | None = None
    """Text file that must be accepted on the page before the first question, such as a line of consent."""
    names: dict[str, str] = field(default_factory=dict)
    """What people read for components of the reward vector, such as learned_1 "saving people"; a learned one
    without is the expert, or expert 1, expert 2, ..."""
    serving: Annotated[launch.Serving, arg(name="")] = field(default_factory=launch.Serving)

    def after(self, before: Answering) -> Answering:
        """Fill in what is not given from how people answered before.

        Raises
        ------
        ValueError
            If the notice cannot be read, or nothing is in it.
        """
        return Answering(
            before.who if self.who is None else self.who,
            before.notice if self.notice is None else _read_notice(self.notice),
            {**before.names, **self.names},
        )


def _read_notice(path: Path) -> str:
    try:
        text = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read the notice {path}: {error}") from error
    if not text:
        raise ValueError(f"the notice {path} is empty")
    return text


def ask_people(
    console: Console,
    directory: RunDirectory,
    run: MoralRun,
    setting: pipeline.Setting,
    resume: bool,
    people: People,
) -> dict[str, Any]:
    """Train in another process while a person answers in this one; returns the run's summary.

    Raises
    ------
    ValueError
        If something does not fit together, or what a page needs is not installed.
    KeyboardInterrupt
        If it is interrupted before the agent is saved.
    """
    on_page = run.teacher.teacher == "web"
    if on_page:
        launch.require_web()
        launch.require_open(people.serving)
    else:
        from moral_algorithms.live.terminal import require_keys

        require_keys()
    answering = people.after(Answering.saved(directory) if resume else Answering())
    names = answering.name_components(run)
    if resume:
        directory.require_config({"kind": "train", **run.to_json()})
    else:
        pipeline.begin_moral(directory, run, setting)
    with hold_session(directory.path):
        answering.save(directory)
        session = LiveSession(directory.path, answering.who, answering.notice, names)

        def announce_end(text: str) -> None:
            console.print(f"{text}; Ctrl-C ends the session" if on_page else text)

        with launch.training(directory.path, announce_end) as trainer:
            # A page is served until Ctrl-C; what that means depends on how far training is by then.
            with suppress(KeyboardInterrupt):
                if on_page:
                    _serve(console, session, trainer, people)
                else:
                    from moral_algorithms.live.terminal import answer_in_terminal

                    answer_in_terminal(session, trainer.state)
            ended = trainer.state()
    # Not by the process, which takes a moment to end after the agent is saved.
    if not directory.summary.exists():
        if ended == "failed":
            raise StorageError(f"training has failed: {trainer.failure()}")
        raise KeyboardInterrupt
    return pipeline.moral(directory, run, setting, resume=True)


def _serve(console: Console, session: LiveSession, trainer: launch.Training, people: People) -> None:
    from moral_algorithms.live.server import make_app

    def announce(link: str) -> None:
        console.print(f"Answer here: {link}")
        console.print("Ctrl-C ends the session; it can be resumed.")

    launch.serve(
        session.run / "live",
        people.serving,
        lambda token, port, hosts: make_app(token, port, hosts, session, trainer=trainer.state),
        announce,
    )
