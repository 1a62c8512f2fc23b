# relocbench with all its packages, for the CPU; --build-arg TORCH_BACKEND=cu128 and `docker run --gpus all` for a GPU.
#
#     docker build -t relocbench .
#     docker run --rm -v "$PWD:/work" relocbench demo --out demo
FROM python:3.11-slim-bookworm
ARG TORCH_BACKEND=cpu
# what Open3D's library is linked against
RUN apt-get update -qq \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1 \
 && rm -rf /var/lib/apt/lists/*
RUN python -m pip install --quiet --no-cache-dir uv==0.13.8
ENV UV_NO_CACHE=1 UV_COMPILE_BYTECODE=1 UV_TORCH_BACKEND=$TORCH_BACKEND
COPY constraints.txt /source/
RUN grep -oE '^(torch|torchvision)==[^ ]+' /source/constraints.txt > /source/torch.txt \
 && uv pip install --system --quiet -r /source/torch.txt
COPY pyproject.toml hatch_build.py README.md LICENSE /source/
COPY baselines /source/baselines
COPY relocbench /source/relocbench
RUN uv pip install --system --quiet -c /source/constraints.txt "/source[cluster]" && rm -rf /source
WORKDIR /work
ENTRYPOINT ["relocbench"]
