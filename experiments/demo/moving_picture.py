"""docs/images/demo.webp of the demo's HTML view, by a headless Chromium: one frame of two, seen from a turning camera.

voodoo-jax replay voodoo_jax/data/demo.mcap --out OUT --html
python -m experiments.demo.moving_picture OUT/demo.html docs/images/demo.webp
"""

import base64
import io
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

SIZE = 560, 420
SCRIPT = """<script>
  const taken = [];
  canvas.style.width = "%dpx"; canvas.style.height = "%dpx";
  eye.distance = 3.1; eye.tilt = 0.16; eye.target = [eye.target[0], eye.target[1], eye.target[2] + 0.05];
  const from = eye.turn;
  for (let i = 0; i < frames; i += 2) {
    eye.turn = from - 0.1 + 0.45 * Math.sin(2 * Math.PI * i / frames); go(i); taken.push(canvas.toDataURL("image/png"));
  }
  document.body.innerHTML = taken.map(t => `<p>${t}</p>`).join("");
</script></body>"""


def main(page: str, out: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "a.html"
        copy.write_text(Path(page).read_text().replace("</body>", SCRIPT % SIZE))
        words = ["chromium", "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
        words += ["--enable-unsafe-swiftshader", f"--user-data-dir={folder}/profile", "--dump-dom", f"file://{copy}"]
        seen = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    found = re.findall(r"<p>data:image/png;base64,([^<]+)</p>", seen)
    first, *others = (Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB") for text in found)
    first.save(out, save_all=True, append_images=others, duration=67, loop=0, quality=60, method=6)
    print(f"{out}: {len(found)} frames, {Path(out).stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(*sys.argv[1:])
