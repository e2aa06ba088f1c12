# The service in a container; docs/install.md says how to run it.
#   docker build --target cpu .            # x86_64 and arm64, on the CPU; the default
#   docker build --target jetson-jp6 .     # JetPack 6.2: Python 3.10, CUDA 12.6, TensorRT 10.3
#   docker build --target jetson-jp7 .     # JetPack 7.2: Python 3.12, CUDA 13.2, TensorRT 10.16
# No container engine was at hand where this was written: it was linted, and the steps of `cpu` were
# run by hand in a Debian root. Bases are pinned by tag; whoever publishes images adds the digests.

FROM python:3.12.13-slim-bookworm AS base-cpu

# TensorRT 10.3 and its Python package, small; JetPack 6.2 has the driver, which the NVIDIA runtime
# brings into the container. A Jetson with another Jetson Linux 36.x takes the same image.
FROM nvcr.io/nvidia/l4t-tensorrt:r10.3.0-runtime AS base-jp6

# There is no L4T image from JetPack 7 on: it runs those for servers. 10.16.1, in 26.04, is the first
# TensorRT of these that knows Orin's GPU; Thor's it knows as well.
FROM nvcr.io/nvidia/tensorrt:26.04-py3 AS base-jp7

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

FROM base-cpu AS build-cpu
COPY docker/constraints.txt /
COPY --from=wheel /wheel /wheel
RUN python3 -m venv /opt/edge \
    && /opt/edge/bin/pip install --no-cache-dir --only-binary=:all: -c /constraints.txt \
       "$(echo /wheel/*.whl)[cpu,clip,choice]" \
    && /opt/edge/bin/pip uninstall --yes pip

# With --system-site-packages, for the base's TensorRT. What its importer finds is looked for, not
# imported: that needs the driver, which is there only when a container runs.
FROM base-jp6 AS build-jp6
COPY docker/constraints.txt /
COPY --from=wheel /wheel /wheel
ENV PIP_CONSTRAINT=
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends python3-venv \
    && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv --system-site-packages /opt/edge \
    && /opt/edge/bin/pip install --no-cache-dir --only-binary=:all: -c /constraints.txt \
       "$(echo /wheel/*.whl)[cpu,clip,choice,tensorrt]" \
    && /opt/edge/bin/python -c \
       'import importlib.util as u; assert u.find_spec("tensorrt"), "no TensorRT for Python in the base"'

FROM base-jp7 AS build-jp7
COPY docker/constraints.txt /
COPY --from=wheel /wheel /wheel
ENV PIP_CONSTRAINT=
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends python3-venv \
    && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv --system-site-packages /opt/edge \
    && /opt/edge/bin/pip install --no-cache-dir --only-binary=:all: -c /constraints.txt \
       "$(echo /wheel/*.whl)[cpu,clip,choice,tensorrt]" \
    && /opt/edge/bin/python -c \
       'import importlib.util as u; assert u.find_spec("tensorrt"), "no TensorRT for Python in the base"'

# From here on the three differ only in what they are made of.
FROM base-jp6 AS jetson-jp6
COPY --from=build-jp6 /opt/edge /opt/edge
COPY docker/healthy /opt/edge/bin/
# The devices of a Jetson's GPU belong to group video.
RUN useradd --uid 10001 --user-group --create-home --groups video edge \
    && install -d -o edge -g edge /var/cache/edge /var/lib/edge
ENV PATH=/opt/edge/bin:$PATH EDGE_CACHE_DIR=/var/cache/edge \
    NUMBA_CACHE_DIR=/var/cache/edge/numba EDGE__HTTP__PORT=7480 \
    NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
USER 10001:10001
WORKDIR /var/lib/edge
VOLUME ["/var/cache/edge", "/var/lib/edge"]
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=15s --timeout=5s --start-period=60s CMD ["/opt/edge/bin/healthy"]
ENTRYPOINT ["edge"]
CMD ["run", "cpu"]

FROM base-jp7 AS jetson-jp7
COPY --from=build-jp7 /opt/edge /opt/edge
COPY docker/healthy /opt/edge/bin/
RUN useradd --uid 10001 --user-group --create-home --groups video edge \
    && install -d -o edge -g edge /var/cache/edge /var/lib/edge
ENV PATH=/opt/edge/bin:$PATH EDGE_CACHE_DIR=/var/cache/edge \
    NUMBA_CACHE_DIR=/var/cache/edge/numba EDGE__HTTP__PORT=7480 \
    NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
USER 10001:10001
WORKDIR /var/lib/edge
VOLUME ["/var/cache/edge", "/var/lib/edge"]
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=15s --timeout=5s --start-period=60s CMD ["/opt/edge/bin/healthy"]
ENTRYPOINT ["edge"]
CMD ["run", "cpu"]

FROM base-cpu AS cpu
COPY --from=build-cpu /opt/edge /opt/edge
COPY docker/healthy /opt/edge/bin/
RUN useradd --uid 10001 --user-group --create-home edge \
    && install -d -o edge -g edge /var/cache/edge /var/lib/edge
ENV PATH=/opt/edge/bin:$PATH EDGE_CACHE_DIR=/var/cache/edge \
    NUMBA_CACHE_DIR=/var/cache/edge/numba EDGE__HTTP__PORT=7480
USER 10001:10001
WORKDIR /var/lib/edge
VOLUME ["/var/cache/edge", "/var/lib/edge"]
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=15s --timeout=5s --start-period=60s CMD ["/opt/edge/bin/healthy"]
ENTRYPOINT ["edge"]
CMD ["run", "cpu"]
