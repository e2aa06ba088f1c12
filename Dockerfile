# The service on a CPU, or on a GPU:
#   docker build .
#   docker build --build-arg BASE=nvcr.io/nvidia/tensorrt:<tag>-py3 --build-arg RUNTIME=gpu,tensorrt .
#   docker run --gpus all …
# NVIDIA's TensorRT image brings CUDA, cuDNN and TensorRT with its Python package; choose one whose
# Python is 3.10 … 3.13. For a Jetson, start from NVIDIA's L4T image of your JetPack and install
# onnxruntime-gpu from NVIDIA's package index (RUNTIME=tensorrt needs no onnxruntime).
# This file was written without a Docker engine at hand: it has not been built.
ARG BASE=python:3.12-slim
FROM ${BASE}
ARG RUNTIME=cpu

RUN useradd --create-home --uid 10001 edge
WORKDIR /opt/edge
COPY pyproject.toml README.md LICENSE ./
COPY edge edge
COPY exporters exporters
COPY models models
COPY config config
RUN pip install --no-cache-dir ".[${RUNTIME}]"

USER edge
ENV EDGE_CACHE_DIR=/home/edge/.cache/edge-vln \
    NUMBA_CACHE_DIR=/home/edge/.cache/numba
# Models, and the engines that TensorRT builds for minutes at the first start.
VOLUME /home/edge/.cache
EXPOSE 7447
# Zenoh's shared memory needs a /dev/shm shared with the sensors' containers (--ipc=host).
ENTRYPOINT ["edge"]
CMD ["run", "cpu"]
