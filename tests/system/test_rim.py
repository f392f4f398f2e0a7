"""Libraries of the rim stay there: the core imports none of them, and host-side modules do not import jax."""

import subprocess
import sys

import pytest

RIM = ("mcap", "trimesh", "matplotlib", "rosbags", "foxglove_schemas_protobuf", "cv2")


@pytest.mark.parametrize(
    "modules,forbidden",
    [
        (("kernels.correspondences", "kernels.gauss_newton", "solve.frame", "solve.scan"), RIM),
        (("records.recording", "config.options", "detect.segmentation"), (*RIM, "jax")),
        # what every replay begins with
        (("batch.log_job", "exporters.foxglove", "exporters.npz"), ("trimesh", "matplotlib", "scipy.optimize")),
    ],
)
def test_imports(modules, forbidden):
    program = "import sys\n" + "".join(f"import voodoo_jax.{m}\n" for m in modules)
    program += f"print([m for m in {forbidden} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
