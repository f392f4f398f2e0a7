# voodoo_jax with what all formats need. Logs and results are mounted:
#   docker build -t voodoo_jax .
#   docker run --rm -v "$PWD:/data" voodoo_jax replay logs --out tracks
FROM python:3.12-slim

# parts of it that compile are built here, if the package index has no wheel for this processor
RUN apt-get update && apt-get install -y --no-install-recommends build-essential && rm -rf /var/lib/apt/lists/*

COPY pyproject.toml README.md LICENSE /src/
COPY voodoo_jax /src/voodoo_jax
RUN pip install --no-cache-dir "/src[all]" && rm -rf /src

# compiled programs are kept if a volume is mounted here: -v voodoo-cache:/cache
ENV VOODOO_JAX_COMPILE_CACHE=/cache
RUN mkdir -m 700 /cache
WORKDIR /data
ENTRYPOINT ["voodoo-jax"]
CMD ["--help"]
