function T(n){return[Math.max(Math.tan(n.zone.x_rad),1e-6),Math.max(Math.tan(n.zone.y_rad),1e-6)]}var w=class extends Error{constructor(o,e,i=!0){super(o);this.advice=e;this.fatal=i;this.name="Problem"}advice;fatal};var _=48,E=16384,A=["a number",()=>!0],P={pitch:["a number above 0",n=>n>0],slope:["a number other than 0",n=>n!==0],center:A,viewCone:["degrees between 0 and 180",n=>n>0&&n<180],DPI:["a number above 0",n=>n>0],screenW:[`1 to ${E} pixels`,I],screenH:[`1 to ${E} pixels`,I]},S={invView:[0,["0 or 1",v]],flipImageX:[0,["0 or 1",v]],flipSubp:[0,["0 or 1",v]],CellPatternMode:[0,["0 to 4",n=>[0,1,2,3,4].includes(n)]]},M=["ROffsetX","ROffsetY","GOffsetX","GOffsetY","BOffsetX","BOffsetY"];function I(n){return Number.isInteger(n)&&n>=1&&n<=E}function v(n){return n===0||n===1}function X(n,r){let o=(t,s,g)=>new w(`${r}: ${t}expected ${s}, found ${JSON.stringify(g)??"nothing"}.`,"Choose the panel's visual.json, as the maker's software stores it.",!1),e;try{e=JSON.parse(n)}catch{throw o("","the JSON of a calibration",n.slice(0,20))}if(typeof e!="object"||e===null)throw o("","the JSON of a calibration",e);let i=(t,s,[g,h])=>{if(typeof s!="number"||!Number.isFinite(s)||!h(s))throw o(`${t}: `,g,s);return s},c=t=>{let s=e[t];return typeof s=="object"&&s!==null&&"value"in s?s.value:s},l=t=>i(t,c(t),P[t]),b=t=>c(t)===void 0?S[t][0]:i(t,c(t),S[t][1]),[u,a,x]=[l("screenW"),l("screenH"),l("slope")],m=b("flipImageX")===1?-1:1,p=Array.isArray(e.subpixelCells)?e.subpixelCells:[],f=b("CellPatternMode"),y=b("flipSubp")===1?[2,1,0]:[0,1,2],d=p.map((t,s)=>{let g=M.map(h=>i(`subpixelCells[${s}].${h}`,t?.[h],A));return y.map(h=>[g[2*h],g[2*h+1]])}),R=[1,2,2,4,2][f];if(d.length>0&&d.length<R)throw o("subpixelCells: ",`${R} kinds of pixels`,d.length);return{serial:typeof e.serial=="string"?e.serial:"",cols:u,rows:a,pitch:l("pitch")*u*Math.cos(Math.atan(1/x))/l("DPI"),tilt:m*a/(u*x),centre:l("center"),inverted:b("invView")===1,coneRad:l("viewCone")*Math.PI/180,cells:d.length>0?d:[y.map(t=>[m*t/3,0])],pattern:d.length>0?f:0}}function C(n,{coneRad:r},o){let e=Math.tan(r/2),i=Math.min(1,T(n)[0]/e);return Array.from({length:o},(c,l)=>[i*Math.tan(((l+.5)/o-.5)*r),0])}var O=`#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`,D=`#version 300 es
precision highp float; precision highp int; precision highp sampler2DArray;
uniform sampler2DArray views;
uniform vec2 size, extent;
uniform float pitch, tilt, centre, count;
uniform bool inverted;
uniform int pattern;
uniform vec2 cells[12];
out vec4 colour;
int kind(ivec2 pixel) {
  if (pattern == 1) return (pixel.x + pixel.y) & 1;
  if (pattern == 2) return pixel.x & 1;
  if (pattern == 3) return (pixel.y + 2 * (pixel.x & 1)) & 3;
  if (pattern == 4) return pixel.y & 1;
  return 0;
}
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec2 on = (gl_FragCoord.xy / size - 0.5) / extent + 0.5;
  vec3 light = vec3(0.0);
  bool inside = all(greaterThanEqual(on, vec2(0.0))) && all(lessThanEqual(on, vec2(1.0)));
  for (int c = 0; c < 3; c++) {
    vec2 lens = (gl_FragCoord.xy + cells[3 * kind(pixel) + c]) / size;
    float phase = fract((lens.x + lens.y * tilt) * pitch - centre);
    if (inverted) phase = 1.0 - phase;
    float view = min(floor(phase * count), count - 1.0);
    light[c] = texture(views, vec3(on.x, 1.0 - on.y, view))[c];
  }
  colour = vec4(inside ? light : vec3(0.0), 1.0);
}`;async function U(n,r){let o=document.createElement("canvas");[o.width,o.height]=[r.cols,r.rows];let e=o.getContext("webgl2",{preserveDrawingBuffer:!0,antialias:!1,alpha:!1,depth:!1});if(!e||e.drawingBufferWidth!==r.cols||e.drawingBufferHeight!==r.rows)throw new w(`The panel has ${r.cols} × ${r.rows} pixels, more than this browser draws.`,"Use another browser or computer.",!1);let{cols:i,rows:c,width_mm:l,height_mm:b}=n.info.field;e.bindTexture(e.TEXTURE_2D_ARRAY,e.createTexture()),e.texStorage3D(e.TEXTURE_2D_ARRAY,1,e.RGBA8,i,c,_);for(let[m,p]of[[e.TEXTURE_MIN_FILTER,e.LINEAR],[e.TEXTURE_MAG_FILTER,e.LINEAR],[e.TEXTURE_WRAP_S,e.CLAMP_TO_EDGE],[e.TEXTURE_WRAP_T,e.CLAMP_TO_EDGE]])e.texParameteri(e.TEXTURE_2D_ARRAY,m,p);try{for(let[m,p]of C(n.info,r,_).entries()){let f=await n.picture(p);e.texSubImage3D(e.TEXTURE_2D_ARRAY,0,0,0,m,i,c,1,e.RGBA,e.UNSIGNED_BYTE,f),f.close()}}finally{n.done()}let u=e.createProgram();for(let[m,p]of[[e.VERTEX_SHADER,O],[e.FRAGMENT_SHADER,D]]){let f=e.createShader(m);e.shaderSource(f,p),e.compileShader(f),e.attachShader(u,f)}if(e.linkProgram(u),e.useProgram(u),e.getError()!==e.NO_ERROR||!e.getProgramParameter(u,e.LINK_STATUS))throw new w(`WebGL2 does not weave ${_} views of ${i} × ${c} pixels here.`,"Use another browser or computer.",!1);let a=m=>e.getUniformLocation(u,m),x=l/b*(r.rows/r.cols);return e.uniform2f(a("size"),r.cols,r.rows),e.uniform2f(a("extent"),Math.min(x,1),Math.min(1/x,1)),e.uniform1f(a("pitch"),r.pitch),e.uniform1f(a("tilt"),r.tilt),e.uniform1f(a("centre"),r.centre),e.uniform1f(a("count"),_),e.uniform1i(a("inverted"),Number(r.inverted)),e.uniform1i(a("pattern"),r.pattern),e.uniform2fv(a("cells"),r.cells.slice(0,4).flat(2)),e.viewport(0,0,r.cols,r.rows),e.drawArrays(e.TRIANGLES,0,3),o}async function $(n){let o=(await window.getScreenDetails?.().catch(()=>{}))?.screens.find(({width:e,height:i,devicePixelRatio:c})=>Math.round(e*c)===n.width&&Math.round(i*c)===n.height);await n.requestFullscreen({navigationUI:"hide",...o&&{screen:o}})}export{X as calibrationOf,$ as fill,C as slopesOf,U as weave};
