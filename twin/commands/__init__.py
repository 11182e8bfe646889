"""What each command of `twin` does; engines are loaded by the command that needs them."""
