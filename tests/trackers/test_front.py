"""What `vj.track` says of arguments that it cannot take."""

import subprocess
import sys

import pytest

CALLS = {
    "vj.track(vj.human(), 'bow.mcap')": "vj.read_log(PATH)",
    "vj.track_people(vj.human(), 3)": "of type int",
    "vj.track('human', 'bow.mcap')": "vj.human()",
    "vj.track_many(vj.human(), ['bow.mcap'])": "vj.read_log(PATH)",
    "vj.track_many('human', 'bow.mcap')": "vj.human()",
}


@pytest.fixture(scope="module")
def said() -> dict[str, str]:
    """What each call raises, in a process without the type checks of tests."""
    tried = "\n".join(f"try: {call}\nexcept TypeError as error: print(error)" for call in CALLS)
    run = subprocess.run(
        [sys.executable, "-c", f"import voodoo_jax as vj\n{tried}"], capture_output=True, text=True, check=True
    )
    return dict(zip(CALLS, run.stdout.splitlines()))


@pytest.mark.parametrize("call", CALLS)
def test_what_is_no_body_or_recording_is_told_with_what_to_try(said, call):
    assert CALLS[call] in said[call]
