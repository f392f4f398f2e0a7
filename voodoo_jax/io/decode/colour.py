"""Messages with colour, grey or compressed images, without decompression, which is done by `io.decode.image_codec`."""

from typing import Any

from voodoo_jax.io.decode.depth_codec import packed_depth
from voodoo_jax.io.decode.image_codec import PIXELS
from voodoo_jax.records.messages import Colour, Image, frame_name, pb_stamp, ros_stamp

COLOUR_KIND = "colour image"


# 7 parameters: the fields of an image message
def colour_image(stamp_ns: int, frame: str, encoding: str, rows: int, columns: int, step: int, data: Any) -> Colour:
    """An image with an encoding of `PIXELS`."""
    name = encoding.strip().lower()
    step = max(step, columns * PIXELS[name], 1)  # some drivers leave step at 0
    return Colour(stamp_ns, frame_name(frame), name, (rows, columns), step, data)


def _compressed(stamp_ns: int, frame: str, format: str, data: Any) -> Colour | Image:
    if not len(data):
        raise ValueError("the image is empty")
    # image_transport writes "rgb8; jpeg compressed bgr8"
    colour = Colour(stamp_ns, frame_name(frame), format.strip().lower(), (0, 0), 0, data)
    return packed_depth(stamp_ns, frame_name(frame), format, data) or colour


CONVERTERS = {
    "sensor_msgs/msg/CompressedImage": lambda m: _compressed(ros_stamp(m.header), m.header.frame_id, m.format, m.data),
    "foxglove.CompressedImage": lambda m: _compressed(pb_stamp(m), m.frame_id, m.format, m.data),
}
