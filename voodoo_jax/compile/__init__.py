"""Executables: made with few options, kept between processes, run over many frames.

Public: `executable.program`, `cache_dir.use_compile_cache`, `xla_options.quick`.
"""
