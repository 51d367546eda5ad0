FROM python:3.11-slim
WORKDIR /opt/soo
COPY requirements.lock requirements-build.lock ./
RUN pip install --no-cache-dir --require-hashes -r requirements.lock && pip install --no-cache-dir --require-hashes --no-deps -r requirements-build.lock
COPY pyproject.toml README.md ./
COPY service service
COPY db db
COPY analyzer_sim analyzer_sim
RUN pip install --no-cache-dir --no-deps --no-build-isolation . && useradd --system --create-home soo && mkdir /data && chown soo /data
USER soo
