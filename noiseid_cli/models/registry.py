"""The built-in systems by name, and models from a user's own file."""

from __future__ import annotations

import hashlib
import importlib
import importlib.machinery
import importlib.util
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import CodeType, ModuleType

from noiseid_cli.errors import ModelError
from noiseid_cli.models.declarations import unknown_name
from noiseid_cli.models.equations import Model

SYSTEMS = {
    "flexible_robot": "noiseid_cli.models.systems.flexible_robot:FlexibleRobot",
    "markov_manipulator": "noiseid_cli.models.systems.markov_manipulator:MarkovManipulator",
    "one_link": "noiseid_cli.models.systems.one_link:OneLink",
    "pendubot": "noiseid_cli.models.systems.pendubot:Pendubot",
}
"""Name of each built-in system and where its class stands; imported when asked for."""


def model_names() -> tuple[str, ...]:
    """Names of the built-in systems."""
    return tuple(SYSTEMS)


def load_model(name: str, parameters: Mapping[str, float] | None = None) -> Model:
    """A built-in system.

    Args:
        name: one of ``model_names()``.
        parameters: values that replace the defaults, by name.

    Raises:
        ModelError: the name of the model or of a parameter is not known.
    """
    if name not in SYSTEMS:
        raise ModelError(unknown_name(f"model {name}", name, SYSTEMS))
    module, _, attribute = SYSTEMS[name].partition(":")
    model_class: type[Model] = getattr(importlib.import_module(module), attribute)
    return model_class(parameters)


def find_model(name: str) -> Model:
    """A model by what a user calls it: the name of a built-in system, or ``FILE.py:CLASS`` for one of their own.

    Raises:
        ModelError: there is none of that name, or the class of a file is not named.
    """
    file, _, class_name = name.rpartition(":")
    if name.endswith(".py"):
        raise ModelError(f"{name} may hold several models: name the class too, as {name}:CLASS")
    return load_model_file(Path(file), class_name) if file.endswith(".py") else load_model(name)


def load_model_file(path: Path | str, class_name: str, parameters: Mapping[str, float] | None = None) -> Model:
    """A model from a file of the user. This runs the file's code, with all rights of the user.

    Args:
        path: Python file that defines a subclass of ``Model``.
        class_name: name of that class.
        parameters: values that replace the defaults, by name.

    Raises:
        ModelError: the file is missing or fails, or the class is not there or declared wrongly.
    """
    path = Path(path).absolute()
    if not path.is_file():
        raise ModelError(f"{path}: no such model file.")
    module = _run(path)
    found = {
        name: item
        for name, item in vars(module).items()
        if isinstance(item, type) and issubclass(item, Model) and item.__module__ == module.__name__
    }
    if class_name in found:
        return _made(path, found[class_name], parameters)
    if hasattr(module, class_name):
        raise ModelError(
            f"{path}: {class_name} is not a model; write class {class_name}(Model), with Model from noiseid_cli.models."
        )
    listed = f"it defines {', '.join(found)}" if found else "it defines none (write class MyRobot(Model))"
    raise ModelError(f"{path}: there is no model class {class_name}; {listed}.")


def _made(path: Path, model_class: type[Model], parameters: Mapping[str, float] | None) -> Model:
    """A model of a user's class, which may have an ``__init__`` or properties of its own."""
    try:
        return model_class(parameters)
    except ModelError:
        raise
    except (Exception, SystemExit) as error:
        line = _line(path, error)
        raise ModelError(f"{path}:{line}: {model_class.__name__}: {type(error).__name__}: {error}") from error


def _line(path: Path, error: BaseException) -> int:
    """The last line of a file that an error went through."""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    return (lines[-1] or 1) if lines else 1


class _SourceLoader(importlib.machinery.SourceFileLoader):
    """Takes the file as it is now: byte code is kept by whole seconds, and would lie among the user's files."""

    def get_code(self, fullname: str) -> CodeType:
        """Compile the source."""
        code: CodeType = self.source_to_code(self.get_data(self.path), self.path)
        return code


def _run(path: Path) -> ModuleType:
    """Import a file under a name of its own, and turn any failure into one sentence with its place."""
    name = f"noiseid_user_model_{hashlib.sha256(str(path).encode()).hexdigest()[:16]}"
    if path.suffix != ".py":
        raise ModelError(f"{path}: not a Python file; its name must end in .py.")
    loader = _SourceLoader(name, str(path))
    module = importlib.util.module_from_spec(importlib.machinery.ModuleSpec(name, loader, origin=str(path)))
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses and the like look their module up
    try:
        loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        line = error.lineno if isinstance(error, SyntaxError) else _line(path, error)
        text = error.msg if isinstance(error, SyntaxError) else error
        raise ModelError(f"{path}:{line}: {type(error).__name__}: {text}") from error
    return module
