"""Files that `dancedata init` writes, with TemplateName and template_name in place of the plug-in's names."""
