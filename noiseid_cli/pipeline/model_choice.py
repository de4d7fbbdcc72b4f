"""From the `model` section to the model itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from noiseid_cli.config.load import LoadedExperiment
from noiseid_cli.config.schema_model import LETTERS, LinearModel, NamedQuantity
from noiseid_cli.errors import ConfigError, DataError

if TYPE_CHECKING:
    from noiseid_cli.models.declarations import Quantity
    from noiseid_cli.models.equations import Model


def chosen_model(loaded: LoadedExperiment) -> Model:
    """The model of an experiment at its parameter values.

    Raises:
        ModelError: a model that comes with noiseid or of a user's file is not there, or fails.
        ConfigError: the matrices of a linear model cannot be read or do not fit each other.
    """
    from noiseid_cli.models.registry import load_model, load_model_file

    choice = loaded.experiment.model
    if choice.linear is not None:
        return _linear(loaded, choice.linear, choice.parameters)
    if choice.name is not None:
        return load_model(choice.name, choice.parameters)
    assert choice.file is not None
    assert choice.class_name is not None
    return load_model_file(loaded.resolve(choice.file), choice.class_name, choice.parameters)


def _linear(loaded: LoadedExperiment, linear: LinearModel, parameters: dict[str, float]) -> Model:
    from noiseid_cli.models.matrix_model import MatrixError, MatrixNames, matrix_model

    matrices = _matrices(loaded, linear)
    names = MatrixNames(*map(_quantities, (linear.states, linear.inputs, linear.noises, linear.outputs)))
    try:
        return matrix_model(matrices, names, linear.discretisation, linear.sample_time, parameters)
    except MatrixError as error:
        own = error.letter if error.letter and getattr(linear, error.letter) is not None else ""
        where = ("model", "linear", own) if own else ("model", "linear")
        raise ConfigError(str(loaded.file), [loaded.problem(where, error.fault)]) from error


def _matrices(loaded: LoadedExperiment, linear: LinearModel) -> dict[str, Any]:
    """The matrices from the experiment and its files; what the experiment gives goes before its file."""
    from noiseid_cli.recordings.matrices import read_matrices, read_matrix

    found: dict[str, Any] = {}
    for letter in LETTERS:
        given = getattr(linear, letter)
        try:
            if given is not None:
                found[letter] = read_matrix(loaded.resolve(given)) if isinstance(given, str) else given
        except DataError as error:
            raise _at(loaded, ("model", "linear", letter), error) from error
    if linear.file is not None:
        needed = [letter for letter in ("A", "C") if letter not in found]
        others = [letter for letter in ("B", "G", "D") if letter not in found]
        try:
            found |= read_matrices(loaded.resolve(linear.file), needed, others)
        except DataError as error:
            raise _at(loaded, ("model", "linear", "file"), error) from error
    return found


def _at(loaded: LoadedExperiment, path: tuple[str, ...], error: Exception) -> ConfigError:
    return ConfigError(str(loaded.file), [loaded.problem(path, str(error))])


def _quantities(given: tuple[NamedQuantity, ...]) -> tuple[Quantity, ...]:
    from noiseid_cli.models.declarations import Quantity

    return tuple(Quantity(q.name, q.unit, q.description) for q in given)
