# Two images: "whole", the default, and "slim", without PyTorch and profile paper: docker build --target slim .
ARG PYTHON_IMAGE=python:3.12.14-slim-trixie

FROM ${PYTHON_IMAGE} AS build
# The compiler's version follows the base image's.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends cmake g++ ninja-build \
    && rm -rf /var/lib/apt/lists/*
RUN python -m venv /opt/build && python -m venv --without-pip /opt/sgmethod
ENV PIP="/opt/build/bin/pip --disable-pip-version-check --no-cache-dir"
ENV INSTALL="${PIP} --python /opt/sgmethod/bin/python install --only-binary :all:"
WORKDIR /source
# Every download must match its hash in the lock files, which `make lock` renews.
COPY service/requirements service/requirements
RUN ${PIP} install --require-hashes --requirement service/requirements/build.txt \
    && ${INSTALL} --require-hashes --requirement service/requirements/slim.txt
COPY pyproject.toml README.md LICENSE ./
COPY sgmethod sgmethod
COPY service service
RUN ${PIP} wheel --no-deps --no-build-isolation --wheel-dir /wheels . \
    && ${INSTALL} --no-deps /wheels/*.whl \
    && find /opt/sgmethod -type d -name tests -prune -exec rm -r {} +

FROM build AS build-torch
# A quarter of PyTorch is tests, and headers for extensions.
RUN ${INSTALL} --require-hashes --requirement service/requirements/torch.txt \
    && torch=$(echo /opt/sgmethod/lib/python3*/site-packages/torch) \
    && rm -r "$torch/include" "$torch/test" \
    && find "$torch/bin" -type f ! -name torch_shm_manager -delete \
    && find /opt/sgmethod -type d -name tests -prune -exec rm -r {} +

FROM ${PYTHON_IMAGE} AS runtime
RUN groupadd --gid 10001 sgmethod \
    && useradd --uid 10001 --gid 10001 --no-create-home --shell /usr/sbin/nologin sgmethod \
    && install --directory --owner=sgmethod --group=sgmethod --mode=0700 /data
# It listens on all addresses: who can reach it depends on how the port is published. Without API keys, it answers only
# requests for localhost, an IP address, or a name in SG_HOST_NAMES.
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
# The request ignores HTTP_PROXY.
HEALTHCHECK --interval=10s --timeout=5s --start-period=20s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as r; r.build_opener(r.ProxyHandler({})).open('http://127.0.0.1:' + os.environ['SG_PORT'] + '/livez', timeout=4)"]
# "serve" runs the web process and workers in one container; "web" or "worker" runs only that.
ENTRYPOINT ["python", "-m", "service"]
CMD ["serve"]

FROM runtime AS slim
COPY --from=build /opt/sgmethod /opt/sgmethod

FROM runtime AS whole
COPY --from=build-torch /opt/sgmethod /opt/sgmethod
