# Run by `cargo xtask release` inside of a Debian that has ffmpeg, Python with NumPy and
# Pillow, and the release in /dist. The argument is Debian's name of the processor.
cd /dist
sha256sum --check --strict --quiet SHA256SUMS
absent() {
    # The shell remembers where a program was.
    hash -r
    if command -v "$1"; then exit 1; fi
}
absent cargo
absent cc

session() {
    folder=$(mktemp -d)
    "$1hil-sim" serve --speed 1 --motion twist --phone --profile "$folder/rig.toml" > "$folder/said" &
    rig=$!
    until grep -q ^port: "$folder/said"; do kill -0 $rig; sleep 0.1; done
    "$1smartdepthsync" doctor --profile "$folder/rig.toml" --port "$(sed -n 's/^port: //p' "$folder/said")"
    kill -INT $rig
    "$1hil-sim" demo --seconds 30 --out "$folder/demo"
}

dpkg --install smartdepthsync_*_"$1".deb
session ''
dpkg --purge smartdepthsync
absent smartdepthsync
tar --extract --directory /opt --file smartdepthsync-*-linux-"$1".tar.gz
session "$(echo /opt/smartdepthsync-*/bin)/"

# Isolated: `PIP_...` of the machine outside would come in with its environment.
pip --isolated install --break-system-packages --no-index --no-deps smartdepthsync_data-*.whl \
    twist_sync-*"$(uname -m)".whl
twist-sync --example
python3 -c 'import smartdepthsync_data'
