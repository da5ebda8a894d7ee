# Sourced by docker/check: starts a container engine where none runs. Sets DOCKER_HOST, DOCKER_CONFIG, PATH and BASE; `skip`
# ends the check.
#
# No registry is needed: Debian's packages provide the engine (unpacked, not installed) and a stand-in for the base image, a
# minimal Debian with its own Python 3.11. This tests the Dockerfile and the service, but not the official base image.

own_engine() {
  [ "$(id -u)" = 0 ] || skip "no container engine answers, and only root can start one"
  command -v apt-get >/dev/null || skip "no container engine answers, and without apt-get none can be installed"
  local sources
  eval "$(apt-config shell PARTS Dir::Etc::sourceparts/d)"
  sources=$(ls "${PARTS}"debian.sources 2>/dev/null) || skip "there is no debian.sources"
  mount -t tmpfs -o size=8g none "$W/ram" || skip "no tmpfs can be mounted"
  quiet apt-get update || skip "Debian's packages cannot be downloaded"
  quiet apt-get install -y --no-install-recommends mmdebstrap runc iptables || skip "Debian's packages cannot be downloaded"
  unpack_engine "$sources" || skip "the engine's packages cannot be downloaded"
  export PATH="$W/bin:$W/engine/usr/bin:$W/engine/usr/sbin:$PATH" DOCKER_HOST="unix://$W/docker.sock" DOCKER_CONFIG="$W/config"
  setsid dockerd -H "$DOCKER_HOST" --data-root "$W/ram/data" --exec-root "$W/exec" --pidfile "$W/dockerd.pid" \
    --storage-driver=overlay2 --iptables=false --ip6tables=false --ip-forward=false >"$W/dockerd.log" 2>&1 &
  for _ in $(seq 60); do docker info >/dev/null 2>&1 && break; sleep 0.5; done
  docker info >/dev/null 2>&1 || skip "the engine did not start: $(tail -1 "$W/dockerd.log")"
  base_image "$sources" || skip "the base image cannot be built"
  node_image
}

# The engine of Debian's next release runs with this release's C library, except for runc, which comes from this release.
unpack_engine() {
  local options=(-qq -o "Dir::Etc::sourcelist=$W/apt/next.sources" -o Dir::Etc::sourceparts=-
    -o "Dir::State::lists=$W/apt/lists" -o "Dir::Cache::archives=$W/apt/archives")
  mkdir -p "$W"/apt/{lists,archives}/partial "$W"/{packages,engine,bin,config}
  awk 'BEGIN { RS = ""; ORS = "\n\n" } !/-security/ { sub(/Suites:[^\n]*/, "Suites: trixie"); print }' "$1" >"$W/apt/next.sources"
  quiet apt-get "${options[@]}" update || return 1
  (cd "$W/packages" && quiet apt-get "${options[@]}" download \
    {docker.io,docker-cli,docker-compose,docker-buildx,containerd,tini}/trixie) || return 1
  for package in "$W"/packages/*.deb; do dpkg-deb -x "$package" "$W/engine" || return 1; done
  ln -sf "$W/engine/usr/libexec/docker/cli-plugins" "$W/config/cli-plugins"
  ln -sf "$(command -v runc)" "$W/bin/runc"
  ln -sf "$W/engine/usr/bin/tini-static" "$W/bin/docker-init"
}

base_image() {
  cat >"$W/hook.sh" <<'HOOK'
#!/bin/sh
set -eu
cd "$1"
rm -f usr/lib/python3.11/EXTERNALLY-MANAGED etc/resolv.conf etc/hostname etc/apt/apt.conf.d/99mmdebstrap etc/apt/sources.list.d/*
for name in python3.11 python3 python; do ln -s ../../bin/python3.11 usr/local/bin/$name; done
: >etc/apt/sources.list
HOOK
  chmod +x "$W/hook.sh"
  TMPDIR="$W/ram" quiet mmdebstrap --mode=root --variant=minbase --components=main --dpkgopt=force-unsafe-io \
    --aptopt='Acquire::Check-Valid-Until "false"' --aptopt='Acquire::Check-Date "false"' \
    --aptopt='APT::Install-Recommends "false"' --dpkgopt='path-exclude=/usr/share/man/*' \
    --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/locale/*' \
    --include=ca-certificates,python3.11,python3.11-venv,nginx-light --customize-hook="$W/hook.sh" \
    bookworm "$W/ram/base.tar" "$1" || return 1
  BASE=gapmes-check/base:local
  docker import -c 'ENV PATH=/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin' -c 'ENV LANG=C.UTF-8' "$W/ram/base.tar" "$BASE" >/dev/null
  export NGINX_IMAGE=$BASE
  rm "$W/ram/base.tar"
}

# Put this machine's own node and npm on the base image. Without npm the image is built without the viewer.
node_image() {
  local npm
  if npm=$(npm root -g 2>/dev/null)/npm && [ -d "$npm" ] && mkdir -p "$W/node/usr/bin" "$W/node/usr/lib/node_modules"; then
    cp -L "$(command -v node)" "$W/node/usr/bin/node"
    cp -r "$npm" "$W/node/usr/lib/node_modules/npm"
    ln -s ../lib/node_modules/npm/bin/npm-cli.js "$W/node/usr/bin/npm"
    printf 'FROM %s\nCOPY usr /usr\n' "$BASE" >"$W/node/Dockerfile"
    quiet docker build -q -t gapmes-check/node:local "$W/node" && NODE=(--build-arg NODE_IMAGE=gapmes-check/node:local) && return
  fi
  say "the image is built without the viewer: npm is not installed"
  NODE=(--build-arg NODE_IMAGE="$BASE" --build-arg VIEWER=skip)
  WITH_VIEWER=no
}

stop_engine() {
  [ -s "$W/dockerd.pid" ] || return 0
  local pid
  pid=$(cat "$W/dockerd.pid")
  kill -TERM "$pid"
  for _ in $(seq 80); do kill -0 "$pid" 2>/dev/null || break; sleep 0.25; done
  umount "$W/exec/netns/default" 2>/dev/null
  ip link del docker0 2>/dev/null
}
