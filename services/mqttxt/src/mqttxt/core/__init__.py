"""What every node runs on: clocks, the command ledger, effects and the runner that carries them out."""
