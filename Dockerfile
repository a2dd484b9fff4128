# syntax=docker/dockerfile:1
ARG PYTHON_IMAGE=python:3.12-slim-bookworm

FROM ${PYTHON_IMAGE} AS build
# The compiler's version follows the base image's.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends cmake g++ ninja-build \
    && rm -rf /var/lib/apt/lists/*
RUN python -m venv /opt/sgmethod
# Which torch: a CPU build serves and is the smallest. Where the default index offers larger builds first, name the
# one to take, for example --build-arg TORCH_PIP_ARGS="--index-url ADDRESS-OF-THE-CPU-INDEX".
ARG TORCH="torch==2.13.0"
ARG TORCH_PIP_ARGS=""
# The arguments are several words.
# hadolint ignore=SC2086
RUN /opt/sgmethod/bin/pip install --no-cache-dir ${TORCH_PIP_ARGS} "${TORCH}"
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY sgmethod sgmethod
COPY service service
RUN /opt/sgmethod/bin/pip wheel --no-cache-dir --no-deps --wheel-dir /wheels . \
    && /opt/sgmethod/bin/pip install --no-cache-dir "$(ls /wheels/*.whl)[torch,service,postgres,s3]"

FROM ${PYTHON_IMAGE}
RUN groupadd --gid 10001 sgmethod \
    && useradd --uid 10001 --gid 10001 --no-create-home --shell /usr/sbin/nologin sgmethod \
    && install --directory --owner=sgmethod --group=sgmethod --mode=0700 /data
COPY --from=build /opt/sgmethod /opt/sgmethod
# Whoever publishes the port decides who reaches it. Without API keys the service answers under localhost and addresses
# alone; SG_HOST_NAMES lists other names.
ENV PATH=/opt/sgmethod/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONSAFEPATH=1 \
    SG_HOST=0.0.0.0 \
    SG_HOST_NAMES=localhost \
    SG_PORT=8000 \
    SG_DATA_DIR=/data
USER 10001:10001
WORKDIR /data
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=20s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as r; r.urlopen('http://127.0.0.1:' + os.environ['SG_PORT'] + '/livez', timeout=4)"]
# Web process and workers in one container; "web" or "worker" in place of "serve" runs one of them alone.
ENTRYPOINT ["python", "-m", "service"]
CMD ["serve"]
