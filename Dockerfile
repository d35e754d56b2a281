# The service in an image: Debian's Python and a virtual environment, nothing else.
# Plain Dockerfile syntax, for docker, podman and `buildah build --isolation chroot`.
ARG BASE=debian:bookworm-slim

# ---- builder: the virtual environment -----------------------------------------------------
FROM ${BASE} AS builder
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends \
        ca-certificates python3 python3-venv \
    && apt-get clean && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/venv
WORKDIR /src
COPY LICENSE README.md pyproject.toml requirements.lock build.lock bearing-twin.cdx.json ./
COPY service service
COPY twin_core twin_core
COPY adapters adapters
COPY deploy/bearing-twin.example.toml deploy/
# Everything that is downloaded is checked by its hash; the installers are not needed at run time.
RUN python3 -m venv /opt/build \
    && /opt/build/bin/pip install --no-cache-dir --require-hashes --requirement build.lock \
    && /opt/build/bin/python -m hatchling build --target wheel --directory /tmp/wheel \
    && /opt/venv/bin/pip install --no-cache-dir --require-hashes --requirement requirements.lock \
    && /opt/venv/bin/pip install --no-cache-dir --no-deps /tmp/wheel/*.whl \
    && /opt/venv/bin/pip uninstall --yes --quiet setuptools pip

# ---- the image ----------------------------------------------------------------------------
FROM ${BASE}
LABEL org.opencontainers.image.title="Bearing Twin" \
      org.opencontainers.image.description="A networked digital twin for grease-lubricated rolling bearings" \
      org.opencontainers.image.licenses="Apache-2.0"
RUN apt-get update \
    && DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends python3 \
    && apt-get clean && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --user-group --no-create-home --home-dir /data \
        --shell /usr/sbin/nologin bearing-twin \
    && install --directory --owner=bearing-twin --group=bearing-twin --mode=0750 \
        /data /var/cache/bearing-twin \
    && install --directory --mode=0755 /etc/bearing-twin
COPY deploy/bearing-twin.example.toml adapters/virtual_bench/bench.dbc /usr/share/bearing-twin/
COPY --from=builder /opt/venv /opt/venv
# The compiled kernels are kept where the service may write: those from the build serve hosts with
# the build machine's kind of processor, any other compiles its own at the first start.
ENV PATH=/opt/venv/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
    LANG=C.UTF-8 \
    PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/var/cache/bearing-twin
USER 10001:10001
RUN ["bearing-twin", "warm-up"]

# To be mounted: /data (the store) and /etc/bearing-twin (the configuration). Not declared as VOLUME:
# buildah 1.28 at random hides what is mounted on a declared one.
WORKDIR /data
EXPOSE 8080
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=15s --timeout=5s --start-period=120s --retries=3 \
    CMD ["python", "-c", "import http.client, os, sys; c = http.client.HTTPConnection('127.0.0.1', int(os.environ.get('BEARING_TWIN__SERVICE__PORT', '8080')), timeout=4); c.request('GET', '/livez'); sys.exit(c.getresponse().status != 200)"]
ENTRYPOINT ["bearing-twin"]
CMD ["serve", "-c", "/etc/bearing-twin/bearing-twin.toml"]
