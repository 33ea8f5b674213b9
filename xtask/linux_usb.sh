#!/usr/bin/env bash
# Makes the machine of `cargo xtask linux-usb` in folder $1: Debian's kernel, and an initramfs with
# busybox, usbip, usbreset and the program $2. Its /init works with the board as a user's computer
# does, and prints a line `STEP name: ok` for each step of hil-sim/rig/tests/it/linux_kernel.rs.
set -euo pipefail
folder=$1 program=$2
mkdir -p "$folder/packages"
folder=$(cd "$folder" && pwd)
cd "$folder/packages"
kernel=$(apt-cache depends linux-image-amd64 | awk '/Depends: linux-image/ { print $2; exit }')
for package in "$kernel" usbip usbutils libudev1 busybox-static; do
    ls "${package}"_*.deb >/dev/null 2>&1 || apt-get -q download "$package" >/dev/null
    [ -d "$package" ] || dpkg -x "${package}"_*.deb "$package"
done
cp "$kernel"/boot/vmlinuz-* "$folder/vmlinuz"

root=$folder/root
rm -rf "$root"
mkdir -p "$root"/{bin,dev,lib64,lib/x86_64-linux-gnu,modules,proc,sys,tmp,var/run}
cp busybox-static/bin/busybox "$root/bin/"
cp usbip/usr/sbin/usbip usbutils/usr/bin/usbreset "$root/bin/"
cp "$program" "$root/bin/smartdepthsync"
cp libudev1/usr/lib/x86_64-linux-gnu/libudev.so.1 "$root/lib/x86_64-linux-gnu/"
for file in "$root"/bin/*; do
    { ldd "$file" 2>/dev/null || true; } | awk '/=> \// { print $3 }' |
        xargs -r cp -uLt "$root/lib/x86_64-linux-gnu/"
done
cp -L /lib64/ld-linux-x86-64.so.2 "$root/lib64/"
for module in usb-common usbcore usbip-core vhci-hcd cdc-acm e1000; do
    find "$kernel/lib/modules" -name "$module.ko" -exec cp {} "$root/modules/" \;
done

cat >"$root/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin
mount -t proc none /proc; mount -t sysfs none /sys; mount -t devtmpfs none /dev
for module in usb-common usbcore usbip-core vhci-hcd cdc-acm e1000; do
    insmod /modules/$module.ko
done
ifconfig lo up; ifconfig eth0 10.0.2.15 up
port=$(sed 's/.*usbip_port=\([0-9]*\).*/\1/' /proc/cmdline)
tty=/dev/ttyACM0

step() { # name, command …
    name=$1; shift
    if "$@" >/tmp/out 2>&1; then result=ok; else result="failed with code $?"; fi
    sed 's/^/    /' /tmp/out
    [ "$result" = ok ] || dmesg | tail -20
    echo; echo "STEP $name: $result"
}
appears() { for _ in $(seq 100); do [ -c $tty ] && return; sleep 0.2; done; echo "no $tty"; false; }
goes() { for _ in $(seq 100); do [ -c $tty ] || return 0; sleep 0.2; done; echo "$tty stays"; false; }
id=$(sed 's/.*usb_id=\([0-9a-f:]*\).*/\1/' /proc/cmdline)
device() { dirname "$(grep -l "${id%:*}" /sys/bus/usb/devices/*/idVendor)"; }
board() { smartdepthsync board --port $tty "$@"; }
info() { appears && board info; }
# A device that has left the bus is attached again by hand, and this is the hand.
attach() { usbip --tcp-port "$port" attach -r 10.0.2.2 -b 1-1; }
hand() { while sleep 1; do usbip port 2>/dev/null | grep -q "Port 00" || attach; done; }

minute() { # of samples and pulses; none may be lost
    board trigger start --fps 30 && board imu --duration 60s --json >/tmp/imu || return
    cat /tmp/imu; board trigger stop
    board info --json >/tmp/info; cat /tmp/info
    ! grep -E '"(lost|missing|dropped)[a-z_]*": *[1-9]' /tmp/imu /tmp/info
}
reopen() { for _ in $(seq 20); do board info || return; done; }
autosuspend() {
    echo 100 >"$(device)/power/autosuspend_delay_ms"; echo auto >"$(device)/power/control"
    sleep 2; cat "$(device)/power/runtime_status"; board info
}
modem_manager() { # its probes of a modem, at a port that the udev rule did not keep from it
    for text in 'AT\r' 'AT\r' 'ATZ\r' 'AT+GCAP\r' '~\000\170\360~'; do
        printf "$text" >$tty || return
        sleep 0.3
    done
    board info
}
unbind() {
    interface=$(basename "$(device)"):1.0
    echo $interface >/sys/bus/usb/drivers/cdc_acm/unbind && goes || return
    echo $interface >/sys/bus/usb/drivers/cdc_acm/bind && info || return
    # And the device as a whole, which sets its configuration again.
    echo 0 >"$(device)/authorized"; goes; echo 1 >"$(device)/authorized"; info
}
reset() { for _ in $(seq 5); do usbreset "$id" && sleep 1 && info || return; done; }
unplug() { # in mid-stream
    for _ in $(seq 3); do
        board trigger start --fps 30; board imu --duration 20s >/tmp/stream 2>&1 &
        sleep 3; usbip detach -p 0; wait $!; goes; info && board trigger stop || return
    done
}

hand >/dev/null 2>&1 &
step enumerate appears
step info info
step reopen reopen
step autosuspend autosuspend
step modem-manager modem_manager
step unbind unbind
step reset reset
step unplug unplug
step minute minute
dmesg | grep -iE "usb|acm|vhci" | tail -60
step end true
poweroff -f
INIT
chmod +x "$root/init"
(cd "$root" && find . | cpio --quiet -o -H newc | gzip -1) >"$folder/initrd"
