# docker build -t modalcam . && docker run --rm --user "$(id -u)" -v "$PWD:/data" modalcam run videos -o out
FROM python:3.11-slim
COPY . /src
RUN pip install --no-cache-dir '/src[all]' && rm -r /src
# Compiled kernels are kept here; any user may run the container.
ENV NUMBA_CACHE_DIR=/tmp/modalcam HOME=/tmp
WORKDIR /data
ENTRYPOINT ["modalcam"]
CMD ["--help"]
