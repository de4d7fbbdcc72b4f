"""From a model class to compiled functions, kept in the user's cache folder.

The generated module is named by a hash of the printed equations, not of the source text: a helper function or
constant that changes the equations changes the name, wherever it stands. Building and printing equations takes a
few hundredths of a second; differentiation and compilation, which take seconds, happen once for each name.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from noiseid_cli.errors import ModelError, machine_error
from noiseid_cli.models.cache import cache_root
from noiseid_cli.models.compiled import Adjoints, CompiledModel
from noiseid_cli.models.equations import Equations, Model
from noiseid_cli.models.matrix_model import MatrixModel
from noiseid_cli.models.schemes import SCHEMES


def compile_model(model: Model, on_compile: Callable[[str], None] | None = None) -> CompiledModel:
    """Compiled functions of a model at its parameter values.

    Args:
        model: the model; its values become ``CompiledModel.parameters``, its equations the functions.
        on_compile: called once with a sentence when the functions are not in the cache and must be compiled.

    Raises:
        ModelError: faulty equations, or the cache folder cannot be written.
        MachineError: nor can it because the disk is full or faulty.
    """
    if isinstance(model, MatrixModel) and model.constant:
        return model.compiled()
    equations = model.equations()
    key = cache_key(equations)
    module = _module(model.name, key, "equations", lambda: _generate(model, equations), on_compile)
    groups = (model.states, model.inputs, model.noises, model.outputs, model.performances)
    states, inputs, noises, outputs, performances = (tuple(q.name for q in group) for group in groups)
    return CompiledModel(
        name=model.name,
        states=states,
        inputs=inputs,
        noises=noises,
        outputs=outputs,
        performances=performances,
        units={q.name: q.unit for group in groups for q in group},
        parameters=model.vector,
        scheme=SCHEMES[model.discretisation],
        drift=module.drift,
        drift_jacobian=module.drift_jacobian,
        output=module.output,
        output_jacobian=module.output_jacobian,
        performance=getattr(module, "performance", None),
        performance_jacobian=getattr(module, "performance_jacobian", None),
        load_adjoints=lambda: _adjoints(model.name, key, equations),
    )


def _adjoints(name: str, key: str, equations: Equations) -> Adjoints:
    """The adjoints live in a module of their own: few runs need them, and compiling them takes as long as the rest."""
    from noiseid_cli.models.codegen import adjoint_source

    module = _module(name, key, "adjoints", lambda: adjoint_source(equations), None)
    return Adjoints(module.drift_adjoint, module.output_adjoint)


def _module(
    name: str, key: str, stem: str, generate: Callable[[], str], on_compile: Callable[[str], None] | None
) -> ModuleType:
    """The generated module ``stem`` of a model, made and compiled where it is not in the cache."""
    path = cache_folder() / key / f"{stem}.py"
    try:
        if not path.exists():
            if on_compile:
                on_compile(f"Compiling the equations of {name} (once on this machine).")
            _write(path, generate())
        return _load(f"noiseid_model_{key}" + ("" if stem == "equations" else f"_{stem}"), path)
    except OSError as error:
        said = f"the compiled equations of {name} cannot be kept in {path.parent}"
        raise machine_error(error, f"{said} (NOISEID_CACHE_DIR takes another folder)") or ModelError(
            f"{said}: {error.strerror or error}. Set NOISEID_CACHE_DIR to a folder that you can write to."
        ) from error


def cache_folder() -> Path:
    """Folder of the compiled models: NOISEID_CACHE_DIR if set, else the user's cache folder."""
    return cache_root() / "models"


def model_key(model: Model) -> str:
    """Hash over everything that a model's functions depend on.

    Raises:
        ModelError: faulty equations.
    """
    if isinstance(model, MatrixModel) and model.constant:
        return model.key()  # without sympy, which takes longer to import than such a model to check
    return cache_key(model.equations())


def cache_key(equations: Equations) -> str:
    """Hash over everything that the generated code depends on."""
    from importlib.metadata import version

    import sympy as sp

    from noiseid_cli.models.codegen import GENERATOR_VERSION

    parts = [f"generator {GENERATOR_VERSION}", f"sympy {sp.__version__}", f"numba {version('numba')}"]
    for group in (equations.x, equations.u, equations.v, equations.p):
        parts.append(" ".join(map(str, group)))
    for term, definition in equations.terms.items():
        parts.append(f"{term} = {sp.srepr(definition)}")
    for expressions in (equations.dynamics, equations.output, equations.performance):
        parts.append("; ".join(map(sp.srepr, expressions)))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _generate(model: Model, equations: Equations) -> str:
    from noiseid_cli.models.codegen import module_source

    try:
        return module_source(equations)
    except ModelError as error:
        raise ModelError(f"{type(model).__name__}: {error}") from None


def _write(path: Path, text: str) -> None:
    """Put a complete file in place; of two processes that write at once, either leaves the same text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        if not path.exists():
            Path(temporary).replace(path)
    finally:
        Path(temporary).unlink(missing_ok=True)


def _load(name: str, path: Path) -> ModuleType:
    """Import the module at a path once per process."""
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ModelError(f"{path} cannot be imported; delete it, it will be made again.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except OSError:
        del sys.modules[name]
        raise
    except Exception as error:
        del sys.modules[name]
        raise ModelError(
            f"the compiled equations in {path.parent} are damaged ({type(error).__name__}: {error}). "
            "Delete that folder; it will be made again."
        ) from error
    return module
