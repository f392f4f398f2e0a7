"""Settings by name, one TOML file each, as `voodoo-jax config` writes them."""
