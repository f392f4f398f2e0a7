"""The front door: every public name is what it says, however often and in whatever order it is asked for."""

import importlib
import inspect
import types

import voodoo_jax as vj


def test_every_name_stays_what_it_is():
    for name in vj.__all__:
        first = getattr(vj, name)
        assert not isinstance(first, types.ModuleType), name
        module, _ = vj._PUBLIC[name]
        importlib.import_module(f"voodoo_jax.{module}")
        assert getattr(vj, name) is first and first.__doc__, name


def test_no_name_is_that_of_a_module():
    """Importing such a module would put it in the name's place."""
    for name in vj.__all__:
        assert importlib.util.find_spec(f"voodoo_jax.{name}") is None, name


def test_unknown_names_are_refused():
    try:
        vj.no_such_thing  # noqa: B018
    except AttributeError as error:
        assert "no_such_thing" in str(error)
    else:
        raise AssertionError("an unknown name was found")
    assert inspect.isfunction(vj.track)


def test_dir_shows_the_public_names_only():
    importlib.import_module("voodoo_jax.exporters.npz")
    assert set(dir(vj)) == {*vj.__all__, "__version__"}
