# The suite in a container: docker build -t rf_exp . && docker run --rm -v "$PWD:/work" rf_exp task=lift_barrier
FROM python:3.11-slim-bookworm
# What scripts/setup.sh would install here, as a layer of its own: Debian 12's own Mesa is too old for SAPIEN.
RUN echo "deb http://deb.debian.org/debian bookworm-backports main" > /etc/apt/sources.list.d/rf_exp-backports.list \
    && apt-get update -qq \
    && apt-get install -y -qq --no-install-recommends libgomp1 \
    && apt-get install -y -qq --no-install-recommends -t bookworm-backports mesa-vulkan-drivers libvulkan1 \
    && rm -rf /var/lib/apt/lists/*
COPY . /rf_exp
RUN /rf_exp/scripts/setup.sh
ENV PATH="/rf_exp/.venv/bin:$PATH"
WORKDIR /work
ENTRYPOINT ["rf-exp"]
CMD ["--help"]
