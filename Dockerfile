# relocbench with all its packages, for the CPU; --build-arg TORCH_BACKEND=cu128 and `docker run --gpus all` for a GPU.
#
#     docker build -t relocbench .
#     docker run --rm -v "$PWD:/work" relocbench demo --out demo
FROM python:3.11-slim-bookworm@sha256:528257d48c1da0dcecc2e725d1ae34498d60c965f1241e39cd6a85a8859bdf84
ARG TORCH_BACKEND=cpu
# what Open3D's library is linked against
RUN apt-get update -qq \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1 \
 && rm -rf /var/lib/apt/lists/*
COPY tools/hashes.txt /source/tools/
WORKDIR /source
RUN sed -n '/^uv==/,/[^\\]$/p' tools/hashes.txt | python -m pip install --quiet --no-cache-dir --require-hashes -r /dev/stdin
ENV UV_NO_CACHE=1 UV_COMPILE_BYTECODE=1
# PyTorch publishes a file for each backend, and hashes.txt has those of one: of these two packages the version alone is pinned.
RUN grep -oE '^(torch|torchvision)==[^ ]+' tools/hashes.txt | UV_TORCH_BACKEND=$TORCH_BACKEND uv pip install --system --quiet -r /dev/stdin
COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY baselines ./baselines
COPY relocbench ./relocbench
RUN uv pip install --system --quiet -c tools/hashes.txt -b tools/hashes.txt ".[cluster]" && rm -rf /source/*
WORKDIR /work
ENTRYPOINT ["relocbench"]
