// Draw the zero level set of nested fields, each twice as fine as the one around it.

#import nested
#import picture
