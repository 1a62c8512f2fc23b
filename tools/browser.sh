#!/usr/bin/env bash
# Install the system's Chromium where there is none, for the tests that open pages in HTML.
set -euo pipefail

if command -v chromium chromium-browser google-chrome >/dev/null; then exit 0; fi
hint="the tests of the pages in HTML need a browser: apt-get install chromium"
if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
  echo "browser: $hint" >&2
  exit 1
fi
echo "browser: installing chromium"
apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null ||
  { echo "browser: $hint" >&2; exit 1; }
