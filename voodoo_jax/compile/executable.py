"""Programs that need not be traced again: whole executables, kept beside jax's compile cache.

jax's own cache spares compiling, but it finds an entry by the lowered program: tracing a tracker takes seconds in each
process. Here an executable is found by what tracing would begin with: the function, this package's code, the static
part of the arguments and the shapes of the others. Whatever does not fit is traced and compiled as ever.
"""

import hashlib
import os
import pickle
import time
from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import cache, update_wrapper
from importlib.metadata import version
from pathlib import Path
from threading import Lock, local
from typing import Any, Generic, ParamSpec, TypeVar, cast

import equinox as eqx
import jax
import jax.core
import jax.monitoring
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from voodoo_jax.compile.cache_dir import alone, jax_cache_aside, keep, kept, spoiled
from voodoo_jax.compile.xla_options import OPTIONS, quick

P = ParamSpec("P")
R = TypeVar("R")
Run = Callable[[list[Any]], list[Any]]  # leaves that are arrays -> leaves of what the function returns
Made = tuple[Run, Any]  # an executable, and the structure of what it returns
LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix")  # whose code is traced too
# what else a trace depends on
CONTEXT = ("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_dtype_promotion", "jax_debug_nans",
           "jax_debug_infs", "jax_disable_jit", "jax_default_device", "jax_num_cpu_devices")  # fmt: skip
_all: list["Program"] = []


class _Clock(local):
    """Of one thread."""

    seconds = 0.0
    waiting = False  # for a Program: all that is counted already


_clock = _Clock()


def _count_compiling(event: str, duration_secs: float, **_: str | int) -> None:
    if event.startswith("/jax/core/compile/") and not _clock.waiting:
        _clock.seconds += duration_secs


jax.monitoring.register_event_duration_secs_listener(_count_compiling)


def seconds_of_waiting() -> float:
    """Seconds for which this thread has waited for programs so far: traced, compiled, loaded, or made by others."""
    return _clock.seconds


def count_waiting(seconds: float) -> None:
    """Counts what another thread has spent on a program for this one."""
    _clock.seconds += seconds


@cache
def code_fingerprint() -> str:
    """Of this package's version and sources: what another version computes is not the same."""
    from voodoo_jax._version import __version__

    digest, root = hashlib.sha256(__version__.encode()), Path(__file__).parents[1]
    for file in sorted(root.rglob("*.py")):
        digest.update(f"{file.relative_to(root)}\0".encode() + file.read_bytes())
    return digest.hexdigest()


class Program(Generic[P, R]):
    """A compiled function like eqx.filter_jit's, for positional arguments and results of arrays."""

    def __init__(self, function: Callable[P, R]):
        update_wrapper(self, function)
        self.function: Callable[..., Any] = function
        self.jitted = eqx.filter_jit(function)  # for other functions' traces and for odd cases
        self.ready: dict[Hashable, Made] = {}  # of this process
        self.making = Lock()  # two threads that want the same make it once
        _all.append(self)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        found = None if kwargs else self.prepare(*args)
        if found is None:
            return self.jitted(*args, **kwargs)
        run, form = found
        return cast(R, jax.tree.unflatten(form, run([x for x in jax.tree.leaves(args) if eqx.is_array(x)])))

    def prepare(self, *args: Any) -> Made | None:
        """The executable for such arguments, and the structure of what it returns; None where jax has to see to it."""
        leaves, tree = jax.tree.flatten(args)
        arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
        if _odd(arrays):
            return None
        static = tuple(None if eqx.is_array(leaf) else (type(leaf), leaf) for leaf in leaves)
        shapes = tuple((x.shape, x.dtype, getattr(x, "weak_type", False)) for x in arrays)
        key = (tree, static, shapes, tuple(getattr(jax.config, name, None) for name in CONTEXT))
        try:
            found = self.ready.get(key)
        except TypeError:  # a static argument that cannot be hashed
            return None
        return self._awaited(key, leaves, tree, arrays) if found is None else found

    def _awaited(self, key: Hashable, leaves: list[Any], tree: Any, arrays: list[Any]) -> Made:
        began, _clock.waiting = time.perf_counter(), True
        try:
            with self.making:
                found = self.ready.get(key)
                if found is None:
                    self.ready[key] = found = self._made(key, leaves, tree, arrays)
                return found
        finally:
            _clock.waiting = False
            _clock.seconds += time.perf_counter() - began

    def _made(self, key: Hashable, leaves: list[Any], tree: Any, arrays: list[Any]) -> Made:
        text = repr((self.__module__, self.function.__qualname__, code_fingerprint(), key, _surroundings()))
        if " at 0x" in text:  # an address is another one in every process
            return self.traced(leaves, tree, arrays)[:2]
        name = hashlib.sha256(text.encode()).hexdigest()
        if (found := _known(name, arrays)) is None:
            with alone(name):  # others that want the same wait for it
                found = _known(name, arrays)
                if found is None:
                    run, form, content = self.traced(leaves, tree, arrays)
                    found = run, form
                    # not every structure can be pickled: only slower next time
                    with suppress(Exception):
                        keep(name, pickle.dumps((content, jax.tree.unflatten(form, range(form.num_leaves)))))
        return found

    def traced(self, leaves: list[Any], tree: Any, arrays: list[Any]) -> tuple[Run, Any, str]:
        """Made as ever: executable, structure of the results, and the name under which the executable is kept."""
        places = [i for i, leaf in enumerate(leaves) if eqx.is_array(leaf)]
        forms = []

        def run(arrays: list[Any]) -> list[Any]:
            full = list(leaves)
            for place, array in zip(places, arrays):
                full[place] = array
            out, form = jax.tree.flatten(self.function(*jax.tree.unflatten(tree, full)))
            forms.append(form)
            return out

        run.__name__ = self.function.__name__
        lowered = jax.jit(run, keep_unused=True).lower(arrays)
        # code that has changed elsewhere lowers to the same program
        content = hashlib.sha256((lowered.as_text() + repr(_surroundings())).encode()).hexdigest()
        form = forms[-1]
        if (loaded := _loaded(content, arrays, form)) is not None:
            return loaded, form, content
        with jax_cache_aside():
            compiled = lowered.compile(quick() or None)
        with suppress(Exception):  # not every device can
            keep(content, serialize(compiled)[0])
        return compiled, form, content


def _known(name: str, arrays: list[Any]) -> Made | None:
    """What some process has made under a name."""
    if (data := kept(name)) is None:
        return None
    try:
        content, numbered = pickle.loads(data)
    except Exception:  # whatever is wrong with it, what follows works without
        spoiled(name)
        return None
    form = jax.tree.structure(numbered)
    run = _loaded(content, arrays, form)
    return None if run is None else (run, form)


def _loaded(content: str, arrays: list[Any], form: Any) -> Run | None:
    if (data := kept(content)) is None:
        return None
    try:
        _find_lapack()
        given, returned = jax.tree.structure(((arrays,), {})), jax.tree.structure([0] * form.num_leaves)
        # of several devices a program is for the first one, see _odd
        return deserialize_and_load(data, given, returned, execution_devices=jax.devices()[:1])
    except Exception:
        spoiled(content)
        return None


def program(function: Callable[P, R]) -> Program[P, R]:
    """Makes a Program of a function of a module."""
    return Program(function)


def forget() -> None:
    """Lets go of all executables of this process, as jax.clear_caches does with others'."""
    for each in _all:
        each.ready.clear()


def _odd(arrays: list[Any]) -> bool:
    """Whether arrays are being traced, or are not where programs run unless told otherwise."""
    here = {jax.devices()[0]}
    return any(
        isinstance(x, jax.core.Tracer) or (isinstance(x, jax.Array) and x.devices() != here) for x in arrays
    ) or bool(jax.config.jax_disable_jit)  # pyright: ignore[reportAttributeAccessIssue]


@cache
def _find_lapack() -> None:
    """Lets jax look up LAPACK's functions, which it does where it lowers a program that calls one: a loaded one would
    call address zero."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((2, 2), "float32"))


@cache
def _surroundings() -> tuple[str, ...]:
    libraries = [f"{name} {version(name)}" for name in LIBRARIES]
    device = jax.devices()[0]
    # by each program's own options, whatever the environment says (not quick(), which compiles to know them)
    settled = tuple(f"--{name}=" for name in OPTIONS.get(device.platform, {}))
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if not flag.startswith(settled)]
    flags.append(os.environ.get("LIBTPU_INIT_ARGS", ""))
    return (*libraries, device.platform, device.device_kind, str(len(jax.devices())), *flags, repr(OPTIONS))
