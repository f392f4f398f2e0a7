"""Start of a segment: start hypotheses, and the stages that improve the first one."""
