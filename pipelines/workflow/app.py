"""The main function of every pipeline: Hydra, a validated configuration, errors in one paragraph, exit codes.

======= =============================================================
code    meaning
======= =============================================================
0       done
1       a bug: a traceback is printed
2       an error in the configuration or in a file: one paragraph
130     Ctrl-C
143     stopped by SIGTERM
======= =============================================================
"""

from __future__ import annotations

import functools
import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from yaml import YAMLError

if TYPE_CHECKING:
    from pipelines.config import PipelineConfig

CONFIG_FOLDER = Path(__file__).resolve().parents[2] / "conf"
_VERSION_BASE = "1.3"
_DEBUG = "HYDRA_FULL_ERROR"
_MAX_MESSAGE = 1900
"""Most characters of an error message at the command line."""

Config = TypeVar("Config", bound="PipelineConfig")

Task = Callable[[Any], None]
"""The work of a pipeline, a function of its typed configuration."""


def app(config_name: str) -> Callable[[Task], Callable[[], None]]:
    """Make ``task(config)`` the main function of a pipeline whose primary file is ``conf/<config_name>.yaml``.

    The typed configuration is complete and validated before the task starts. Its schema is the annotation of
    ``config``, a class of :mod:`pipelines.config` that is imported when a job starts: ``--help`` and ``--cfg job`` need
    Hydra only. For the same reason, stages import what they call within functions.

    In a sweep (``-m``), every job writes its artefact to a separate folder: ``paths.sweep``, or
    ``<outputs>/sweeps/<pipeline>/<overrides>``.
    """

    def decorate(task: Task) -> Callable[[], None]:
        @functools.wraps(task)
        def main() -> None:
            sys.exit(_main(config_name, task))

        return main

    return decorate


def compose(config_name: str, schema: type[Config], overrides: Sequence[str] = ()) -> Config:
    """Compose and validate the configuration of a pipeline outside its app, or of another pipeline within an app.

    Raises:
        ConfigError: an override is invalid.
    """
    # Within an app, Hydra is already initialized with the same search path.
    if GlobalHydra.instance().is_initialized():
        return _composed(config_name, schema, overrides)
    with hydra.initialize_config_dir(version_base=_VERSION_BASE, config_dir=str(CONFIG_FOLDER)):
        return _composed(config_name, schema, overrides)


def command_line_overrides() -> list[str]:
    """The overrides with which the running pipeline was started; empty outside an app."""
    return list(HydraConfig.get().overrides.task) if HydraConfig.initialized() else []


def override_keys(overrides: Sequence[str]) -> set[str]:
    """The keys set by ``overrides``: ``["+a.b=1", "c@d=2"]`` -> ``{"a.b", "c"}``."""
    return {re.sub(r"^[+~]*", "", override.split("=", 1)[0]).split("@", 1)[0] for override in overrides}


def to_typed(config: DictConfig, schema: type[Config]) -> Config:
    """Resolve and validate a composed configuration.

    Raises:
        ConfigError: a key is unknown or missing, or a value has the wrong type or is out of range.
    """
    from visualrhp.parameters import validated

    return validated(schema, OmegaConf.to_container(config, resolve=True, throw_on_missing=True))


def _composed(config_name: str, schema: type[Config], overrides: Sequence[str]) -> Config:
    try:
        return to_typed(hydra.compose(config_name, list(overrides)), schema)
    except Exception as error:
        mistake = mistake_of(error)
        if mistake is None or mistake is error:
            raise
        raise mistake from error


def _main(config_name: str, task: Task) -> int:
    debug = os.environ.get(_DEBUG, "0") not in ("", "0")
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    logging.raiseExceptions = False  # a full disk under the log file is reported once, by what it stops
    failures: list[Exception] = []
    failed_jobs: dict[str, Exception] = {}
    artefacts: set[str] = set()

    def run(config: DictConfig) -> None:
        """Hydra's task function; stores the failure of a single run rather than raising it to Hydra."""
        from pipelines.workflow.surroundings import check_device

        is_sweep = HydraConfig.get().mode == RunMode.MULTIRUN
        try:
            typed = to_typed(config, _schema_of(task))
            if is_sweep:
                typed = _in_sweep_folder(typed, artefacts)
            check_device(typed.device)
            task(typed)
        except Exception as error:
            mistake = mistake_of(error)
            if mistake is None or debug:
                raise
            if is_sweep:  # Hydra raises the first failure of a sweep when all jobs are done
                failed_jobs[HydraConfig.get().job.override_dirname] = mistake
                raise mistake from error
            failures.append(mistake)

    if message := _unusable_outputs(sys.argv[1:]):
        print(f"Error: {message}", file=sys.stderr)
        return 2
    try:
        with _hydra_for_one_run():
            hydra.main(version_base=_VERSION_BASE, config_path=str(CONFIG_FOLDER), config_name=config_name)(run)()
    except KeyboardInterrupt as interrupt:
        message, code = ("Stopped by SIGTERM", 143) if isinstance(interrupt, _Terminated) else ("Interrupted", 130)
        print(f"{message}; rerun the command to resume.", file=sys.stderr)
        return code
    except Exception as error:
        mistake = mistake_of(error)
        if mistake is None or debug:
            raise
        failures.append(mistake)
    for job, failure in failed_jobs.items():
        print(f"The job {job} failed.", file=sys.stderr)
        _report(failure)
    for failure in failures:
        if failure not in failed_jobs.values():
            _report(failure)
    return 2 if failures else 0


def _report(failure: Exception) -> None:
    text = " ".join(str(failure).split())
    print(f"Error: {text if len(text) <= _MAX_MESSAGE else text[:_MAX_MESSAGE] + ' ...'}", file=sys.stderr)


def _unusable_outputs(arguments: Sequence[str]) -> str | None:
    """What is wrong with ``paths.outputs``, where Hydra writes before the configuration is checked; None if nothing."""
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key.lstrip("+") != "paths.outputs":
            continue
        path = value.strip("\"' ")
        if path in ("", "null", "~") or path.startswith("~/"):
            return f"paths.outputs={value} is not the path of a folder; it should be like outputs or /data/outputs."
    return None


def _schema_of(task: Task) -> type[PipelineConfig]:
    import pipelines.config

    return getattr(pipelines.config, task.__annotations__["config"])


class _Terminated(KeyboardInterrupt):
    """SIGTERM, which cleans up like Ctrl-C."""


def _terminate(number: int, frame: FrameType | None) -> None:
    raise _Terminated


@contextmanager
def _hydra_for_one_run() -> Iterator[None]:
    """Make Hydra raise exceptions instead of printing them, and SIGTERM an exception; restore both afterwards."""
    before = os.environ.get(_DEBUG)
    os.environ[_DEBUG] = "1"
    handler = signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, handler)
        os.environ.pop(_DEBUG)
        if before is not None:
            os.environ[_DEBUG] = before
        # Hydra does not reset them, and a later run in this process would reuse them.
        GlobalHydra.instance().clear()
        HydraConfig.instance().cfg = None


def mistake_of(error: Exception) -> Exception | None:
    """The error to report at the command line; None if ``error`` is a bug."""
    # Imported lazily, since `--help` does not need the library.
    from pipelines.workflow.surroundings import storage_error
    from visualrhp.errors import ConfigError, VisualRHPError

    if isinstance(error, VisualRHPError):
        return error
    if isinstance(error, YAMLError):
        return ConfigError(f"A configuration file is not valid YAML: {error}")
    if isinstance(error, HydraException | OmegaConfBaseException):
        return _config_error(error)
    if isinstance(error, UnicodeDecodeError | RecursionError) and (explained := _unreadable_configuration()):
        return explained
    if isinstance(error, TypeError | ValueError) and _is_raised_by_hydra(error):
        return ConfigError(
            "A group has a value that is not the name of one of its files: arguments for groups are group=file, such "
            "as scale=quick."
        )
    return storage_error(error)


def _in_sweep_folder(config: Config, taken: set[str]) -> Config:
    """Give every job of a sweep a separate artefact, named by its overrides, so that rerunning the sweep resumes it.

    Raises:
        ConfigError: the artefact of the job is among those of earlier jobs, ``taken``, to which it is added.
    """
    from pipelines.workflow.names import path_name
    from visualrhp.errors import ConfigError

    artefact = config.paths.sweep
    if artefact is None:
        job = HydraConfig.get().job
        artefact = str(
            Path(config.paths.outputs) / "sweeps" / job.name / path_name(job.override_dirname or str(job.num))
        )
    if os.path.realpath(artefact) in taken:
        raise ConfigError(
            f"Two jobs of the sweep would write their results to {artefact}: paths.sweep has to depend on every key "
            "that the sweep varies. The second one was not run."
        )
    taken.add(os.path.realpath(artefact))
    return replace(config, paths=replace(config.paths, artefact=artefact))


# -------------------------------------------------------------------------------------- Hydra's errors, in one sentence
def _config_error(error: Exception) -> Any:
    """The ConfigError that explains ``error`` at the command line."""
    from visualrhp.errors import ConfigError
    from visualrhp.parameters import suggestion

    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    text = str(error)
    if isinstance(cause, MissingMandatoryValue):
        return ConfigError(f"The key {cause.full_key} has no value (???); set it.")
    if match := re.search(r"Could not (?:find|load) '(?P<group>[^']*)/(?P<option>[^']*)'", text):
        # Hydra's list ends at an empty line.
        options = re.search(r"Available options in '[^']*':\n(.*?)(\n\n|\nConfig search path|\Z)", text, re.DOTALL)
        names = options.group(1).split() if options else []
        return ConfigError(
            f"{match['group']}={match['option']} is not known. {suggestion(match['option'], names)} "
            f"(conf/{match['group']}/ holds {', '.join(sorted(names)) or 'nothing'}.)"
        )
    if match := re.search(r"Could not override '(?P<key>[^']*)'", text):
        return ConfigError(_unknown_key(match["key"], cause))
    if match := re.search(r"Error parsing override '(?P<override>[^']*)'", text):
        return ConfigError(_unreadable(match["override"]))
    if "override_grammar" in text:  # not all errors of Hydra's parser name the argument
        return ConfigError(_unreadable(_first_unreadable(sys.argv[1:]) or text.partition("\n")[0]))
    if match := re.search(
        r"Multiple values for (?P<key>\S+)\. To override a value use 'override [^:]*: (?P<value>.*)'", text
    ):
        return ConfigError(
            f"{match['key']} already has a value: write {match['key']}={match['value']}, without a plus sign."
        )
    if match := re.search(r"Ambiguous value for argument '(?P<override>[^']*)'", text):
        return ConfigError(
            f"{match['override']} lists several values, which is a sweep: add -m to run all of them, or write a list "
            "as key=[a,b]."
        )
    return ConfigError(" ".join(re.sub(r"\s*(full_key|object_type|reference_type)[=:].*", "", text).split()))


def _unreadable_configuration() -> Exception | None:
    """The error for the first configuration file that cannot be read; None if all can."""
    from visualrhp.errors import ConfigError

    for path in sorted(CONFIG_FOLDER.rglob("*.yaml")):
        try:
            OmegaConf.create(path.read_text(encoding="utf-8"))
        except (UnicodeDecodeError, RecursionError) as error:
            reason = "is not UTF-8" if isinstance(error, UnicodeDecodeError) else "refers to itself"
            return ConfigError(f"The configuration file {path} {reason}; mend it, or get it back with git.")
        except Exception:  # reported by Hydra
            continue
    return None


def _is_raised_by_hydra(error: BaseException) -> bool:
    """Whether the innermost frame of ``error`` is in Hydra, which does not check all values of groups."""
    traceback = error.__traceback__
    if traceback is None:
        return False
    while traceback.tb_next is not None:
        traceback = traceback.tb_next
    return Path(traceback.tb_frame.f_code.co_filename).is_relative_to(Path(hydra.__file__).parent)


def _unreadable(override: str) -> str:
    key, equals, value = override.partition("=")
    value = value.strip("\"'").replace('"', '\\"')
    example = f"""'{key}="{value}"'""" if key and equals and value else """'title="a, b"'"""
    return (
        f"The argument {override} cannot be read: arguments are key=value, and values with special characters are "
        f"quoted for Hydra and for the shell: {example}."
    )


def _first_unreadable(arguments: Sequence[str]) -> str | None:
    """The first argument of the command line that Hydra's parser refuses."""
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parser = OverridesParser.create()
    for argument in arguments:
        try:
            parser.parse_override(argument)
        except Exception:  # of the parser generator, too
            if not argument.startswith("-"):
                return argument
    return None


def _unknown_key(key: str, cause: BaseException) -> str:
    from visualrhp.parameters import suggestion

    parent = getattr(cause, "parent_node", None)
    last = str(getattr(cause, "key", None) or key.rpartition(".")[2])
    groups = sorted(entry.name for entry in CONFIG_FOLDER.iterdir() if entry.is_dir())
    if isinstance(parent, DictConfig):
        where = str(getattr(cause, "full_key", "") or key)
        return f"There is no key {where}. {suggestion(last, [str(name) for name in parent])}"
    if key in groups:
        return (
            f"This pipeline has no group {key}. If an experiment sets it, that experiment is for another "
            "pipeline, named in the first lines of its file."
        )
    return f"There is no key or group {key} here. {suggestion(key, groups)}"
