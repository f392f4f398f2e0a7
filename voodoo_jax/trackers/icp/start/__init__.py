"""How a segment begins: start hypotheses, and the stages that better the first one."""
