"""What only the tests need beside the virtual environment: tshark, a Chromium, and a virtual machine with netem."""
