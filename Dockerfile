# voodoo_jax with what all formats need, without compilers, as a user without rights. Logs and results are mounted:
#   docker build -t voodoo_jax .
#   docker run --rm -v "$PWD:/data" voodoo_jax replay logs --out tracks
# The user in it has the number 1000; with another one: --user "$(id -u)" -e VOODOO_JAX_COMPILE_CACHE=off
FROM python:3.12-slim AS built

# parts of it that compile are built here, if the package index has no wheel for this processor
RUN apt-get update && apt-get install -y --no-install-recommends build-essential && rm -rf /var/lib/apt/lists/*
RUN python -m venv /opt/voodoo
COPY pyproject.toml README.md LICENSE /src/
COPY voodoo_jax /src/voodoo_jax
RUN /opt/voodoo/bin/pip install --no-cache-dir "/src[all]"

FROM python:3.12-slim
COPY --from=built /opt/voodoo /opt/voodoo
# compiled programs are kept if a volume is mounted here: -v voodoo-cache:/cache
ENV PATH=/opt/voodoo/bin:$PATH VOODOO_JAX_COMPILE_CACHE=/cache
RUN useradd --create-home --uid 1000 voodoo && install -d -o voodoo -m 700 /cache && install -d -o voodoo /data
USER voodoo
WORKDIR /data
ENTRYPOINT ["voodoo-jax"]
CMD ["--help"]
