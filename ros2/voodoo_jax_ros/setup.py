from setuptools import setup

NAME = "voodoo_jax_ros"
setup(
    name=NAME,
    version="0.3.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/track.launch.py"]),
        (f"share/{NAME}/config", ["config/track.yaml"]),
    ],
    install_requires=["setuptools", "voodoo_jax"],
    license="Apache-2.0",
    entry_points={"console_scripts": [f"track = {NAME}.node:main"]},
)
