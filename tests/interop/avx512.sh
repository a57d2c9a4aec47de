#!/usr/bin/env bash
# Trains configs/smoke.json and runs the kernels' tests on the AVX-512 path, on any x86-64: Debian's kernel, with the
# programs as its initial file system, boots in Bochs, which emulates a CPU with AVX-512. Requires the recorded hash and
# that the tests pass. For Debian 12, as root; installs Debian's emulator.
set -euo pipefail
cd "$(dirname "$0")/../.."
here=$PWD
work=${WORK:-$(mktemp -d)}
root=$work/root
mkdir -p "$root"/{bin,proc,dev,tmp} "$work/iso" "$work/packages"

apt-get update --quiet=2
apt-get install --yes --quiet=2 --no-install-recommends \
    bochs bochs-term bochsbios busybox-static cpio isolinux syslinux-common xorriso
(
    cd "$work/packages"
    kernel=$(apt-cache depends linux-image-cloud-amd64 | sed -n 's/.*Depends: //p')
    apt-get download --quiet=2 "$kernel"
    dpkg -x "$kernel"_*.deb .
    cp boot/vmlinuz-* "$work/iso/linux"
)

# The programs, at the paths that they were compiled for, with their libraries.
tests=$(cargo test --release --locked --no-run --test it 2>&1 | sed -n 's/.*Executable.*(\(.*\))/\1/p')
program=${CARGO_TARGET_DIR:-$here/target}/release/cartpole-dqn
cp "$(command -v busybox)" "$root/bin/busybox"
cp "$tests" "$root/bin/tests"
libraries=$(ldd "$tests" "$program" | sed -n 's|.*\s\(/\S*\) (0x.*|\1|p' | sort -u)
# shellcheck disable=SC2086
cp --parents --dereference "$program" "$here/configs/smoke.json" $libraries "$root"

cat >"$root/init" <<EOF
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin
mount -t proc proc /proc
mount -t devtmpfs dev /dev
exec >/dev/console 2>&1
cd "$here"
CARTPOLE_DQN_SIMD=avx512 $program train --config configs/smoke.json --out /tmp/run --quiet
cat /tmp/run/summary.json
/bin/tests kernels:: simd:: --test-threads 1
echo "tests: exit code \$?"
sleep 2
poweroff -f
EOF
chmod +x "$root/init"
(cd "$root" && find . | cpio --create --format=newc --quiet | gzip -1) >"$work/iso/initrd"

# Bochs 2.7 reports the size of the whole compacted XSAVE area wrongly, whereupon Linux turns AVX off; so without XSAVEC
# and XSAVES (321, 323).
cp /usr/lib/ISOLINUX/isolinux.bin /usr/lib/syslinux/modules/bios/ldlinux.c32 "$work/iso"
cat >"$work/iso/isolinux.cfg" <<EOF
default linux
label linux
kernel linux
append initrd=initrd console=ttyS0 quiet mitigations=off nokaslr clearcpuid=321,323
EOF
xorriso -as mkisofs -quiet -o "$work/boot.iso" \
    -b isolinux.bin -c boot.cat -no-emul-boot -boot-load-size 4 -boot-info-table "$work/iso"

cat >"$work/bochsrc" <<EOF
display_library: term
cpu: model=corei7_skylake_x, count=1, ips=50000000
memory: guest=1024, host=1024
romimage: file=/usr/share/bochs/BIOS-bochs-latest
vgaromimage: file=/usr/share/bochs/VGABIOS-lgpl-latest
ata0: enabled=1, ioaddr1=0x1f0, ioaddr2=0x3f0, irq=14
ata0-master: type=cdrom, path=$work/boot.iso, status=inserted
boot: cdrom
com1: enabled=1, mode=file, dev=$work/serial.txt
log: $work/bochs.log
panic: action=fatal
EOF
# Its debugger waits for a command; its display needs a terminal; powering off makes it exit with 1. It has been seen to
# stop and wait for its terminal halfway; hence the limit.
printf 'c\nquit\n' >"$work/commands"
TERM=xterm timeout 3600 script --quiet --command "bochs -f $work/bochsrc -rc $work/commands" /dev/null \
    </dev/null >"$work/screen.txt" || true

cat "$work/serial.txt"
expected=$(cat tests/data/smoke_weights.sha256)
if ! grep --quiet "\"weights_sha256\": *\"$expected\"" "$work/serial.txt" ||
    ! grep --quiet 'tests: exit code 0' "$work/serial.txt"; then
    echo "FAILED: on AVX-512 the weights are not $expected, or a test failed: $work/serial.txt" >&2
    exit 1
fi
