"""Body files that come with the package: `human`, `human10` (Knoop 2007), `arm`, `dog`."""
