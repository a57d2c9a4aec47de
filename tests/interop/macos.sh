#!/usr/bin/env bash
# Compiles the program for macOS, for both processors, without a warning, and links it whole if zig is there, whose linker knows
# macOS: pip install ziglang. Nothing is run.
set -euo pipefail
cd "$(dirname "$0")/../.."
work=${WORK:-$(mktemp -d)}
for target in aarch64-apple-darwin x86_64-apple-darwin; do
    rustup target add "$target"
    RUSTFLAGS='-D warnings' cargo check --locked --target "$target"
    echo "passed  $target compiles without a warning"
done

python3 -c 'import ziglang' 2> /dev/null || {
    echo 'not linked: there is no zig; pip install ziglang'
    exit 0
}
for target in aarch64 x86_64; do
    # Rust names the system and its libraries itself. zig has the library of the system, and iconv is not used.
    cat > "$work/$target-linker" << LINKER
#!/usr/bin/env bash
words=()
for word in "\$@"; do
    case \$word in
        -arch | arm64 | x86_64 | -liconv | -mmacosx-version-min=* | --target=*) ;;
        *) words+=("\$word") ;;
    esac
done
exec python3 -m ziglang cc -target $target-macos "\${words[@]}"
LINKER
    chmod +x "$work/$target-linker"
    variable=CARGO_TARGET_$(tr a-z A-Z <<< "$target")_APPLE_DARWIN_LINKER
    # Only macOS's own strip reads its programs.
    env "$variable=$work/$target-linker" CARGO_PROFILE_DEV_STRIP=false \
        cargo build --locked --target "$target-apple-darwin" --target-dir "$work/target"
    file "$work/target/$target-apple-darwin/debug/cartpole-dqn"
done
