# The service in a container; docs/install.md says how to run it.
#   docker build .                         # x86_64 and arm64, on the CPU
#   docker build --build-arg BASE=jp6 .    # JetPack 6.2: Python 3.10, CUDA 12.6, TensorRT 10.3
#   docker build --build-arg BASE=jp7 .    # JetPack 7.2: Python 3.12, CUDA 13.2, TensorRT 10.16
# packages/try-image builds and runs that for the CPU; those for a Jetson were only linted. Bases are
# pinned by tag; add the digests when you publish an image.
ARG BASE=cpu

FROM python:3.12.13-slim-bookworm AS base-cpu

# TensorRT 10.3 and its Python package, small; JetPack 6.2 has the driver, which the NVIDIA runtime
# brings into the container. A Jetson with another Jetson Linux 36.x takes the same image.
FROM nvcr.io/nvidia/l4t-tensorrt:r10.3.0-runtime AS base-jp6
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility

# There is no L4T image from JetPack 7 on: it runs those for servers. 10.16.1, in 26.04, is the first
# TensorRT of these that knows Orin's GPU; Thor's it knows as well.
FROM nvcr.io/nvidia/tensorrt:26.04-py3 AS base-jp7
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility

# The package itself, the same for all.
FROM base-cpu AS wheel
WORKDIR /src
RUN pip install --no-cache-dir build==1.6.1 hatchling==1.33.0
COPY pyproject.toml README.md LICENSE ./
COPY edge edge
COPY exporters exporters
COPY models models
COPY config config
RUN python -m build --wheel --no-isolation --outdir /wheel

# hadolint ignore=DL3006
FROM base-${BASE} AS build
ARG BASE
COPY docker/constraints.txt /
COPY --from=wheel /wheel /wheel
ENV PIP_CONSTRAINT=
# A Jetson's has --system-site-packages, for the base's TensorRT. What its importer finds is looked
# for, not imported: that needs the driver, which is there only when a container runs.
# hadolint ignore=DL3008
RUN if [ "$BASE" = cpu ]; then python3 -m venv /opt/edge; \
    else apt-get update && apt-get install --yes --no-install-recommends python3-venv \
      && rm -rf /var/lib/apt/lists/* && python3 -m venv --system-site-packages /opt/edge; \
    fi \
    && /opt/edge/bin/pip install --no-cache-dir --only-binary=:all: -c /constraints.txt \
       "$(echo /wheel/*.whl)[cpu,clip,choice$([ "$BASE" = cpu ] || echo ,tensorrt)]" \
    && if [ "$BASE" != cpu ]; then /opt/edge/bin/python -c \
       'import importlib.util as u; assert u.find_spec("tensorrt"), "no TensorRT for Python in the base"'; \
    fi \
    && /opt/edge/bin/pip uninstall --yes pip

# hadolint ignore=DL3006
FROM base-${BASE} AS edge
COPY --from=build /opt/edge /opt/edge
COPY docker/healthy /opt/edge/bin/
# Group video has the devices of a Jetson's GPU, and cameras.
RUN useradd --uid 10001 --user-group --create-home --groups video edge \
    && install -d -o edge -g edge /var/cache/edge /var/lib/edge
# XDG_STATE_HOME: a stop lasts as long as the volume, not as the container.
ENV PATH=/opt/edge/bin:$PATH EDGE_CACHE_DIR=/var/cache/edge XDG_STATE_HOME=/var/lib/edge \
    NUMBA_CACHE_DIR=/var/cache/edge/numba EDGE__HTTP__PORT=7480
USER 10001:10001
WORKDIR /var/lib/edge
VOLUME ["/var/cache/edge", "/var/lib/edge"]
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=15s --timeout=5s --start-period=60s CMD ["/opt/edge/bin/healthy"]
ENTRYPOINT ["edge"]
CMD ["run", "cpu"]
