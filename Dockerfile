FROM python:3.11.13-slim-bookworm@sha256:86adf8dbadc3d6e82ee5dd2c74bec2e1c2467cdad47886280501df722372d2e1
WORKDIR /opt/soo
COPY requirements.lock requirements-build.lock ./
RUN pip install --no-cache-dir --require-hashes --no-deps -r requirements.lock && pip install --no-cache-dir --require-hashes --no-deps -r requirements-build.lock
COPY pyproject.toml README.md ./
COPY service service
COPY db db
COPY analyzer_sim analyzer_sim
RUN pip install --no-cache-dir --no-deps --no-build-isolation . && useradd --system --create-home soo && mkdir -m 700 /data /opt/machine-code && chown soo /data /opt/machine-code
USER soo
ENV NUMBA_CACHE_DIR=/opt/machine-code
# machine code of the filter, which the first row would wait for
RUN python -m service.pipeline.first_rows
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s --retries=6 \
  CMD ["python", "-c", "import urllib.request as u; u.urlopen('http://127.0.0.1:8000/readyz', timeout=4)"]
CMD ["soo", "serve", "--host", "0.0.0.0", "--port", "8000", "--database", "sqlite:////data/soo.db"]
