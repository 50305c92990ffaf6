# The package with its viewer and an OpenGL library. Without a command it shows the policy that ships, at port 8080.
#
#   docker build -t ogmp_sb3 .
#   docker run -p 8080:8080 ogmp_sb3
#   docker run -v "$PWD/runs:/work/runs" ogmp_sb3 ogmp-train task=parkour rho=0.5
FROM python:3.11-slim

RUN apt-get update \
    && apt-get install -y --no-install-recommends g++ git libosmesa6 make \
    && rm -rf /var/lib/apt/lists/*
ENV MUJOCO_GL=osmesa NUMBA_CACHE_DIR=/var/cache/numba

# Further arguments of the installation of torch, e.g. to choose a build without CUDA.
ARG TORCH_ARGS=""
WORKDIR /opt/ogmp_sb3
COPY constraints.txt .
RUN pip install --no-cache-dir -c constraints.txt $TORCH_ARGS torch
COPY . .
RUN pip install --no-cache-dir -c constraints.txt '.[viewer,export]'

# Functions that are compiled at the first start are kept in the image.
WORKDIR /work
RUN ogmp-check parkour && chmod -R a+rwX /var/cache/numba /work
EXPOSE 8080
CMD ["ogmp-play", "run=parkour", "host=0.0.0.0"]
