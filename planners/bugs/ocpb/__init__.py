"""The Operative Critical Point Bug (Das, Dutta and Debnath): one file per idea of the paper."""
