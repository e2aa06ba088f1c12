# The service on a CPU. For a Jetson, start from NVIDIA's L4T image of your JetPack and install
# the `gpu` extra from NVIDIA's package index instead.
# This file was written without a Docker engine at hand: it has not been built.
FROM python:3.12-slim

RUN useradd --create-home --uid 10001 edge
WORKDIR /opt/edge
COPY pyproject.toml README.md LICENSE ./
COPY edge edge
COPY exporters exporters
COPY models models
COPY config config
RUN pip install --no-cache-dir '.[cpu]'

USER edge
ENV EDGE_CACHE_DIR=/home/edge/.cache/edge-vln \
    NUMBA_CACHE_DIR=/home/edge/.cache/numba
VOLUME /home/edge/.cache
EXPOSE 7447
# Zenoh's shared memory needs a /dev/shm shared with the sensors' containers (--ipc=host).
ENTRYPOINT ["edge"]
CMD ["run", "cpu"]
